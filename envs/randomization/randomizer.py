"""Maps an episode's index to the appearance of its scene, and to its instruction."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError
from envs.core.json_values import to_json_values
from envs.randomization.channels import CHANNELS, Channel, Instructed, Scene, Workspace
from envs.randomization.materials import MaterialLibrary
from envs.randomization.splits import Split, load_split
from envs.scenario import Appearance, CameraCfg, LightingCfg, ScenarioCfg

if TYPE_CHECKING:
    from envs.state import State


class Randomizer:
    """Samples the looks and the words of episodes: a pure function of seed, split and the episode's index.

    Args:
        base: Appearance at level 0; what no channel changes keeps it.
        cameras: The scenario's cameras; the camera channel moves each that is fixed in the world.
        channels: Channels that vary; see :func:`~envs.randomization.levels.channels_of`.
        split: One of :data:`~envs.randomization.splits.SPLIT_NAMES`, or a split that was loaded with the same
            library.
        seed: The protocol's seed.
        library: Materials; the procedural ones by default.
        lighting: Ranges of the lighting channel; by default those of ``scenario``.
        scenario: Whose room is furnished, with every camera that it may be seen through; without it the
            environment channel has no furniture.
        task: Whose instruction is drawn, and reworded by channels that do; without it there is none.
        workspace: What channels that change starts ask of the task.

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
        workspace: Workspace | None = None,
    ) -> None:
        self.base = base
        self.cameras = tuple(cameras)
        self.channels = tuple(channels)
        self.library = library or MaterialLibrary.built_in()
        self.split = split if isinstance(split, Split) else load_split(split, library)
        self._drawn_from = self.split.drawn
        self.seed = seed
        self.lighting = lighting or (scenario.lighting if scenario is not None else LightingCfg())
        self.scenario, self.task, self.workspace = scenario, task, workspace
        # The task's poses are no matter of a channel's: the task draws them.
        self._channels = {name: CHANNELS.get(name)() for name in self.channels if name != "task"}

    def appearance(self, episode: int) -> Appearance:
        """Returns how the scene looks in an episode; at level 0 exactly the base.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        appearance = self.base
        for _, channel, draw, scene in self._drawn(episode, "apply"):
            appearance = channel.apply(appearance, draw, scene)
        return appearance

    @property
    def changes_starts(self) -> bool:
        """Whether a channel changes the start of episodes, and not their look alone."""
        return any(channel.changes_starts for channel in self._channels.values())

    def instruction(self, episode: int) -> str:
        """Returns the instruction of an episode: the task's draw, as the channels reword it.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        instruction = self._scene(episode).instruction
        for _, channel, draw, scene in self._drawn(episode, "instruct"):
            instruction = channel.instruct(instruction, draw, scene)
        return instruction

    def start(self, episode: int, state: "State") -> "State":
        """Returns the start of an episode, one row, as the channels change the task's.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        for _, channel, draw, scene in self._drawn(episode, "start"):
            state = channel.start(state, draw, scene)
        return state

    def draws(self, episode: int) -> dict[str, Any]:
        """Returns the sampled values of an episode by channel, as plain JSON values.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        return {name: to_json_values(draw) for name, _, draw, _ in self._drawn(episode)}

    def _drawn(self, episode: int, changing: str = "") -> Iterator[tuple[str, Channel, Any, Scene]]:
        """Yields the draws of an episode: of all channels, or of those that have a method of their own."""
        scene = self._scene(episode)
        for name, channel in self._channels.items():
            if not changing or channel.has(changing):
                yield name, channel, channel.sample(scene.rng(name), channel.split(scene), scene), scene

    def _scene(self, episode: int) -> Scene:
        """Returns what the channels draw for."""
        if episode not in self.split:
            valid = self.split.episodes
            raise ConfigError(
                f"Episode {episode} is not in the split '{self.split.name}' ({self.split.version}), which "
                f"has {len(valid)} episodes, {valid[0]} to {valid[-1]}. Take one of them, or name the other "
                f"split."
            )
        return Scene(
            split=self._drawn_from,
            seed=self.seed,
            episode=episode,
            library=self.library,
            lighting=self.lighting,
            cameras=self.cameras,
            scenario=self.scenario,
            task=self.task,
            workspace=self.workspace,
        )
