"""What varies from episode to episode: a registry of channels, and their base class.

A channel of another package registers through the entry-point group ``roboverse.channels``, or by
``CHANNELS.add`` in a plugin. It varies alone (``only=fog``, ``alone=[fog]``) or with others
(``only=environment+camera+fog``).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from envs.core.errors import ConfigError
from envs.core.registry import Registry
from envs.randomization.seeding import channel_rng

if TYPE_CHECKING:
    import numpy as np

    from envs.randomization.language import WordingBank
    from envs.randomization.materials import MaterialLibrary
    from envs.randomization.splits import Split
    from envs.scenario import Appearance, CameraCfg, LightingCfg, RobotCfg, ScenarioCfg
    from envs.state import State

CHANNELS: "Registry[type[Channel]]" = Registry("channel", group="roboverse.channels")

for _name, _target, _summary in (
    ("environment", "environment:EnvironmentChannel", "materials of surfaces, table's yaw, furniture"),
    ("camera", "cameras:CameraChannel", "poses of the cameras that are fixed in the world"),
    ("lighting", "lights:LightingChannel", "lamps, and how everything reflects"),
    ("robot", "robot_start:RobotChannel", "posture of the arm at the start"),
    ("sensor", "sensor:SensorChannel", "noise, blur, JPEG and exposure of the cameras"),
    ("layout", "layout:LayoutChannel", "objects that have no part in the task"),
    ("language", "language.channel:LanguageChannel", "wording of the instruction: sentence frames, synonyms"),
):
    CHANNELS.add(_name, f"envs.randomization.{_target}", summary=_summary)

TEST_SHARE = 0.1
"""Share of what a channel may draw that is held out for the test split, as in RoboVerse (2504.18904)."""


class Instructed(Protocol):
    """What channels ask of a task: its instruction."""

    def instruction(self, rng: "np.random.Generator", /) -> str:
        """Draws an episode's instruction."""
        ...

    def wordings(self, instruction: str, /) -> "WordingBank":
        """Returns the wordings of a drawn instruction."""
        ...


class Workspace(Protocol):
    """What a channel may ask of a task: :class:`envs.tasks.workspace.TaskWorkspace` answers.

    Attributes:
        robot: The robot that acts.
        support_z_m: Height of what objects stand on.
    """

    robot: "RobotCfg"
    support_z_m: float

    def touches(self, state: "State", qpos: "np.ndarray") -> bool:
        """Whether the robot in the posture ``qpos`` (J,) touches itself, the table or an object."""
        ...

    def hand(self, qpos: "np.ndarray") -> "np.ndarray":
        """Returns where the hand is in the posture ``qpos`` (J,), m, (3,)."""
        ...

    def way(self, state: "State", rng: "np.random.Generator") -> "np.ndarray":
        """Returns points of the hand on the expert's way from a start of one row, m, (P, 3)."""
        ...

    def heights(self, state: "State", points: "np.ndarray") -> "np.ndarray":
        """Returns how high what never moves is at points (K, 2), m, (K,); NaN where nothing can stand."""
        ...

    def boxes(self, state: "State") -> "np.ndarray":
        """Returns least and largest corners of boxes round all geoms of the objects, m, (B, 2, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Scene:
    """What a channel draws for.

    Attributes:
        split: The side of the frozen split that is drawn from, with its materials, furniture and cameras.
        seed: The protocol's seed.
        episode: The episode's index.
        library: Materials.
        lighting: Ranges of the lamps.
        cameras: The scenario's cameras.
        scenario: The scenario, or None where only its appearance is known.
        task: The task, or None where only its scenario is known.
        workspace: The task's; None where no episode starts.
    """

    split: "Split"
    seed: int
    episode: int
    library: "MaterialLibrary"
    lighting: "LightingCfg"
    cameras: "tuple[CameraCfg, ...]"
    scenario: "ScenarioCfg | None" = None
    task: "Instructed | None" = None
    workspace: Workspace | None = None

    def rng(self, stream: str) -> "np.random.Generator":
        """Returns a stream of random numbers of this episode, independent of those of other names."""
        return channel_rng(self.seed, stream, self.episode)

    @property
    def instruction(self) -> str:
        """The instruction that the task draws for the episode; empty without a task."""
        return "" if self.task is None else self.task.instruction(self.rng("instruction"))

    @property
    def wordings(self) -> "WordingBank":
        """Known and held-out wordings of the instruction.

        Raises:
            ConfigError: There is no task.
        """
        if self.task is None:
            raise ConfigError(
                "A channel rewords the task's instruction, and this randomizer has no task. Make the "
                "environment with EnvSpec.make, or pass task= to Randomizer."
            )
        return self.task.wordings(self.instruction)


class Channel(ABC):
    """One part of an episode that varies: what may be drawn, a draw, and the episode that has it.

    A draw changes the look of the scene (:meth:`apply`), its start (:meth:`start`), or its words
    (:meth:`instruct`). All are pure functions, so that an episode is the same in every simulator and process.

    Attributes:
        changes_images: Whether it changes images after they are rendered: it sets an appearance's ``sensor``.
    """

    changes_images: ClassVar[bool] = False

    @classmethod
    def has(cls, method: str) -> bool:
        """Whether it overrides a method that changes nothing by default, such as ``"start"``."""
        return getattr(cls, method) is not getattr(Channel, method)

    @property
    def changes_starts(self) -> bool:
        """Whether it has a :meth:`start` or a :meth:`scenario`."""
        return self.has("start") or self.has("scenario")

    @abstractmethod
    def split(self, scene: Scene) -> Any:
        """Returns what episodes of ``scene.split`` may draw: nothing that the other split may draw too.

        :func:`divided` divides a list.
        """

    @abstractmethod
    def sample(self, rng: "np.random.Generator", allowed: Any, scene: Scene) -> Any:
        """Draws for one episode.

        Args:
            rng: Random numbers of this channel in this episode.
            allowed: What :meth:`split` returned.
            scene: What it is drawn for.

        Returns:
            A dataclass, or plain JSON values: ``env.draws`` gives it, and ``roboverse view`` shows it.
        """

    def apply(self, appearance: "Appearance", draw: Any, scene: Scene) -> "Appearance":
        """Returns the appearance with a draw; what the channel does not change keeps its look."""
        del draw, scene
        return appearance

    def start(self, state: "State", draw: Any, scene: Scene) -> "State":
        """Returns the start of an episode with a draw.

        Args:
            state: The start so far, one row, float64 on the CPU.
            draw: What :meth:`sample` returned.
            scene: What it was drawn for, with its workspace.
        """
        del draw, scene
        return state

    def scenario(self, scenario: "ScenarioCfg", split: "Split") -> "ScenarioCfg":
        """Returns the scene of all episodes of a split, such as one with further objects.

        Raises:
            ConfigError: The channel cannot vary in this scene.
        """
        del split
        return scenario

    def instruct(self, instruction: str, draw: Any, scene: Scene) -> str:
        """Returns the instruction with a draw, for a channel that changes it; by default it stays.

        Args:
            instruction: What the channels before this one made of the task's instruction.
            draw: What :meth:`sample` returned.
            scene: What it is drawn for; ``scene.wordings`` has other wordings of the instruction.
        """
        del draw, scene
        return instruction


def divided[T](values: Sequence[T], split: str) -> tuple[T, ...]:
    """Returns a split's part of a list: every tenth value, beginning with the tenth, is of the test split.

    Args:
        values: At least ten, in an order that stays.
        split: ``"train"`` or ``"test"``.

    Raises:
        ValueError: There are fewer than ten.
    """
    every = round(1 / TEST_SHARE)
    if len(values) < every:
        raise ValueError(f"A channel needs at least {every} values to divide, given {len(values)}.")
    is_test = split == "test"
    return tuple(value for i, value in enumerate(values) if (i % every == every - 1) == is_test)
