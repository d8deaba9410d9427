"""One object that means "the environment of this run": everything that decides what an episode is.

Commands, datasets, checkpoints, results and the LeRobot plugin carry an :class:`EnvSpec`. It is plain data:
making one imports no simulator, and its JSON form is the same on every machine.
"""

import hashlib
import inspect
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self

from envs.core.errors import ConfigError, unknown_name, unknown_option
from envs.core.json_values import to_json_values
from envs.randomization.levels import channels_of

if TYPE_CHECKING:
    from envs.randomization import MaterialLibrary
    from envs.scenario import ScenarioCfg
    from envs.simulators.base import Handler
    from envs.tasks.base import Task
    from envs.torch_env import TorchVectorEnv
    from envs.vector_env import RoboVerseVectorEnv

MIN_IMAGE_SIZE, MAX_IMAGE_SIZE = 16, 2048
"""Limits of ``image_size``, pixels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EnvSpec:
    """The environment of a run.

    Attributes:
        task: Registered task.
        task_kwargs: Options of the task: fields of its dataclass.
        robot: Registered robot that does the task; empty is the task's own.
        simulator: Registered simulator.
        simulator_settings: Settings of the simulator that replace the scene's, such as ``njmax`` of
            mujoco_warp.
        renderer: Registered renderer, or another simulator that renders the images.
        cameras: Cameras that are observed; empty takes the task's first, and ``[all]`` in a command all of
            them.
        image_size: Pixels along the shorter side of every image; most cameras' images are square.
        scenario: Changes of the task's scene, as nested mappings of the fields of
            :class:`~envs.scenario.ScenarioCfg`.
        level: Randomization level, 0 to 3.
        only: One channel that varies alone, in place of a level, or several joined by ``+``.
        materials: Folder of images in place of the built-in materials; with ``+`` before it, beside them.
    """

    task: str = "PickCube"
    task_kwargs: Mapping[str, Any] = field(default_factory=dict)
    robot: str = ""
    simulator: str = "mujoco"
    simulator_settings: Mapping[str, Any] = field(default_factory=dict)
    renderer: str = "warp"
    cameras: tuple[str, ...] = ()
    image_size: int = 256
    scenario: Mapping[str, Any] = field(default_factory=dict)
    level: int = 0
    only: str | None = None
    materials: str = ""

    def __post_init__(self) -> None:
        if not MIN_IMAGE_SIZE <= self.image_size <= MAX_IMAGE_SIZE:
            raise ConfigError(
                f"image_size must be {MIN_IMAGE_SIZE} to {MAX_IMAGE_SIZE} pixels, given {self.image_size}."
            )
        if len(set(self.cameras)) != len(self.cameras):
            raise ConfigError(f"cameras={list(self.cameras)} names a camera twice. Name each once.")
        channels_of(self.level, self.only)

    @property
    def channels(self) -> tuple[str, ...]:
        """Randomization channels that vary, in their fixed order."""
        return channels_of(self.level, self.only)

    def replace(self, **changes: Any) -> Self:
        """Returns a copy with other values; see :func:`dataclasses.replace`."""
        return replace(self, **changes)

    def to_json(self) -> dict[str, Any]:
        """Returns its fields as JSON values, which :meth:`from_json` takes back; no robot is left out."""
        values = to_json_values(self)
        return values if self.robot else {key: value for key, value in values.items() if key != "robot"}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Returns the spec of JSON values; what is absent or None takes its default.

        Raises:
            UnknownNameError: A key is no field.
            ConfigError: A value is out of range.
        """
        known = [item.name for item in fields(cls)]
        for key in values:
            if key not in known:
                raise unknown_name("field of an environment", str(key), known)
        given = {key: value for key, value in values.items() if value is not None}
        if "cameras" in given:
            given["cameras"] = tuple(given["cameras"])
        return cls(**given)

    @property
    def hash(self) -> str:
        """First 16 hex digits of the SHA-256 of the JSON form: equal for equal environments."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def control_hz(self) -> float:
        """Control steps per second."""
        return self.make_task().scenario.physics.control_hz

    def make_task(self) -> "Task":
        """Returns the task, with its robot and its scene changed.

        Raises:
            UnknownNameError: There is no such task or robot, or no such part of its scene.
            ConfigError: An option has a value that it may not have, or the robot cannot do the task.
        """
        from envs.tasks.make import make_task

        return make_task(self.task, self.task_kwargs, self.scenario, self.robot)

    def make(
        self,
        num_envs: int = 1,
        *,
        split: str = "train",
        observation: Literal["pixels", "state", "full"] = "pixels",
        actions: Literal["task", "rl"] = "task",
        protocol_seed: int = 0,
        num_threads: int = 0,
        autoreset_mode: str = "NextStep",
    ) -> "RoboVerseVectorEnv":
        """Returns ``num_envs`` environments that are stepped together, with a NumPy interface.

        Args:
            num_envs: Number of environments.
            split: ``"train"``, ``"validation"`` or ``"test"``: which episodes.
            observation: What is observed; see :class:`~envs.vector_env.RoboVerseVectorEnv`.
            actions: ``"task"`` for the task's controller, ``"rl"`` for that of reinforcement learning.
            protocol_seed: Seeds every random number.
            num_threads: Threads of the simulator; 0 means one per core.
            autoreset_mode: Gymnasium's: what ``step`` does with an environment whose episode is over.

        Raises:
            UnknownNameError: A name does not exist.
            ConfigError: A value is out of range.
        """
        from envs.randomization import CHANNELS, MaterialLibrary, Randomizer, load_split
        from envs.tasks.make import in_scene
        from envs.tasks.workspace import TaskWorkspace
        from envs.vector_env import RoboVerseVectorEnv

        task = self.make_task()
        library = MaterialLibrary.chosen(self.materials)
        varying = [CHANNELS.get(name)() for name in self.channels if name != "task"]
        workspace = None
        if any(channel.changes_starts for channel in varying):
            workspace = TaskWorkspace(task)
            scenario = task.scenario
            for channel in varying:
                scenario = channel.scenario(scenario, load_split(split, library))
            task = in_scene(task, scenario)
        scene = self._scene(task, num_envs).seen_by(self.cameras, self.image_size)
        randomizer = Randomizer(
            scene.appearance,
            task.scenario.cameras,  # all of them: an episode does not depend on which are observed
            channels=self.channels,
            split=split,
            seed=protocol_seed,
            library=library,
            scenario=task.scenario,
            task=task,
            workspace=workspace,
        )
        disturbed = any(channel.changes_images for channel in varying)
        env = RoboVerseVectorEnv(
            task,
            self._handler(scene, num_envs, num_threads, library, disturbed=disturbed),
            randomizer,
            observation=observation,
            actions=actions,
            autoreset_mode=autoreset_mode,
        )
        env.env_spec = self
        return env

    def make_torch(
        self,
        num_envs: int,
        *,
        observation: Literal["state", "pixels", "pixels_and_state"] = "state",
        num_frames: int = 3,
        substeps: int | None = None,
        num_threads: int = 0,
        **options: Any,
    ) -> "TorchVectorEnv":
        """Returns ``num_envs`` environments with a Torch interface, on the simulator's device.

        Args:
            num_envs: Number of environments.
            observation: ``"state"`` for the task's ``rl_observation``; ``"pixels"`` for images, see
                :class:`~envs.pixel_env.PixelVectorEnv`, and ``"pixels_and_state"`` for the robot's own state
                beside them, as bytes. The randomization level has no effect.
            num_frames: Frames of an observation of images.
            substeps: Physics steps per control step; the task's by default. Fewer are longer, faster and
                less accurate.
            num_threads: Threads of the simulator; 0 means one per core.
            **options: Options of :class:`~envs.torch_env.TorchVectorEnv`, such as ``seed`` and ``device``.

        Raises:
            UnknownNameError: A name does not exist.
            ConfigError: A value is out of range, or the task has no camera to observe.
        """
        from envs.pixel_env import PixelAndStateVectorEnv, PixelVectorEnv, watched
        from envs.randomization import MaterialLibrary
        from envs.simulators import HANDLERS
        from envs.torch_env import TorchVectorEnv

        of_images = {"pixels": PixelVectorEnv, "pixels_and_state": PixelAndStateVectorEnv}
        if observation not in ("state", *of_images):
            raise unknown_name("observation", str(observation), ("state", *of_images))
        task = self.make_task()
        scene = self._scene(task, num_envs)
        if substeps is not None:
            scene = replace(scene, physics=scene.physics.divided(substeps))
        if observation == "state":
            handler = HANDLERS.get(self.simulator)(scene, num_envs, num_threads=num_threads)
            env = TorchVectorEnv(task, handler, **options)
        else:
            scene = watched(self.task, scene, self.cameras, self.image_size)
            handler = self._handler(scene, num_envs, num_threads, MaterialLibrary.chosen(self.materials))
            env = of_images[observation](task, handler, num_frames=num_frames, **options)
        env.env_spec = self
        return env

    def _scene(self, task: "Task", num_envs: int) -> "ScenarioCfg":
        """Returns the task's scene with the simulator's settings."""
        if num_envs < 1:
            raise ConfigError(f"num_envs must be at least 1, given {num_envs}.")
        return task.scenario.tuned(self.simulator, self.simulator_settings)

    def _handler(
        self,
        scene: "ScenarioCfg",
        num_envs: int,
        num_threads: int,
        library: "MaterialLibrary",
        *,
        disturbed: bool = False,
    ) -> "Handler":
        from envs.simulators.disturbed import DisturbedHandler
        from envs.simulators.hybrid import make_handler

        handler = make_handler(
            self.simulator,
            scene,
            num_envs,
            renderer=self.renderer,
            num_threads=num_threads,
            textures=library.texture,
        )
        return DisturbedHandler(handler) if disturbed or scene.appearance.sensor.disturbs else handler


def split_options(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Divides options into fields of :class:`EnvSpec` and options of :meth:`EnvSpec.make`.

    Raises:
        UnknownOptionError: An option is neither.
    """
    names = {item.name for item in fields(EnvSpec)}
    runtime = set(inspect.signature(EnvSpec.make).parameters) - {"self", "num_envs"}
    for key in options:
        if key not in names | runtime:
            raise unknown_option("An environment", key, names | runtime)
    return (
        {key: value for key, value in options.items() if key in names},
        {key: value for key, value in options.items() if key in runtime},
    )
