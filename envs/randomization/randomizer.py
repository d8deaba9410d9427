"""Maps an episode's index to the appearance of its scene, and to its instruction."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from envs.core.errors import ConfigError
from envs.core.plain_values import plain
from envs.randomization.channels import CHANNELS, Channel, Scene
from envs.randomization.materials import MaterialLibrary
from envs.randomization.seeding import channel_rng
from envs.randomization.splits import Split, load_split
from envs.scenario import Appearance, CameraCfg, LightingCfg, ScenarioCfg

if TYPE_CHECKING:
    import numpy as np

    from envs.randomization.language import WordingBank


class Instructed(Protocol):
    """What a randomizer asks of a task."""

    def instruction(self, rng: "np.random.Generator", /) -> str:
        """Draws an episode's instruction."""
        ...

    def wordings(self, instruction: str, /) -> "WordingBank":
        """Returns the wordings of a drawn instruction."""
        ...


class Randomizer:
    """Samples the looks and the words of episodes: a pure function of seed, split and the episode's index.

    Args:
        base: Appearance at level 0; what no channel changes keeps it.
        cameras: The scenario's cameras; the camera channel moves each that is fixed in the world.
        channels: Channels that vary; see :func:`~envs.randomization.levels.channels_of`.
        split: ``"train"`` or ``"test"``, or a split that was loaded with the same library.
        seed: The protocol's seed.
        library: Materials; the procedural ones by default.
        lighting: Ranges of the lighting channel; by default those of ``scenario``.
        scenario: Whose room is furnished, with every camera that it may be seen through; without it the
            environment channel has no furniture.
        task: Whose instruction is drawn, and reworded by channels that do; without it there is none.

    Raises:
        UnknownNameError: if a channel or the split does not exist.
    """

    def __init__(
        self,
        base: Appearance,
        cameras: Sequence[CameraCfg],
        *,
        channels: Sequence[str],
        split: str | Split,
        seed: int,
        library: MaterialLibrary | None = None,
        lighting: LightingCfg | None = None,
        scenario: ScenarioCfg | None = None,
        task: Instructed | None = None,
    ) -> None:
        self.base = base
        self.cameras = tuple(cameras)
        self.channels = tuple(channels)
        self.library = library or MaterialLibrary.built_in()
        self.split = split if isinstance(split, Split) else load_split(split, library)
        self.seed = seed
        self.lighting = lighting or (scenario.lighting if scenario is not None else LightingCfg())
        self.scenario = scenario
        self.task = task
        # The task's poses are no matter of a channel: the task draws them.
        self._channels = {name: CHANNELS.get(name)() for name in self.channels if name != "task"}

    def appearance(self, episode: int) -> Appearance:
        """Returns how the scene looks in an episode; at level 0 exactly the base.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        appearance = self.base
        for _, channel, draw, scene in self._drawn(episode):
            appearance = channel.apply(appearance, draw, scene)
        return appearance

    def instruction(self, episode: int) -> str:
        """Returns the instruction of an episode: the task's draw, as the channels reword it.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        instruction = self._drawn_instruction(episode)
        for _, channel, draw, scene in self._drawn(episode):
            instruction = channel.instruct(instruction, draw, scene)
        return instruction

    def draws(self, episode: int) -> dict[str, Any]:
        """Returns the sampled values of an episode by channel, as plain JSON values.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        return {name: plain(draw) for name, _, draw, _ in self._drawn(episode)}

    def _drawn(self, episode: int) -> Iterator[tuple[str, Channel, Any, Scene]]:
        if episode not in self.split:
            valid = self.split.episodes
            raise ConfigError(
                f"Episode {episode} is not in the split '{self.split.name}' ({self.split.version}), which "
                f"has {len(valid)} episodes, {valid[0]} to {valid[-1]}. Take one of them, or name the other "
                f"split."
            )
        instruction = self._drawn_instruction(episode)
        scene = Scene(
            split=self.split,
            seed=self.seed,
            episode=episode,
            library=self.library,
            lighting=self.lighting,
            cameras=self.cameras,
            scenario=self.scenario,
            instruction=instruction,
            wordings=self.task.wordings(instruction) if self.task is not None else None,
        )
        for name, channel in self._channels.items():
            yield name, channel, channel.sample(scene.rng(name), channel.split(scene), scene), scene

    def _drawn_instruction(self, episode: int) -> str:
        """Returns the instruction that the task draws."""
        return "" if self.task is None else self.task.instruction(channel_rng(self.seed, "instruction", episode))
