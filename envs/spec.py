"""One object that means "the environment of this run": everything that decides what an episode is.

Commands, datasets, checkpoints, results and the LeRobot plugin carry an :class:`EnvSpec`. It is plain data:
making one imports no simulator, and its JSON form is the same on every machine.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self

from envs.core.errors import ConfigError, unknown_name
from envs.core.plain_values import plain
from envs.randomization.levels import channels_of

if TYPE_CHECKING:
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
        simulator: Registered simulator.
        simulator_settings: Settings of the simulator that replace the scene's, such as ``njmax`` of
            mujoco_warp.
        renderer: Registered renderer, or another simulator that renders the images.
        cameras: Cameras that are observed; empty takes the task's first.
        image_size: Height and width of every image, pixels.
        scenario: Changes of the task's scene, as nested mappings of the fields of
            :class:`~envs.scenario.ScenarioCfg`.
        level: Randomization level, 0 to 3.
        only: One channel that varies alone, in place of a level.
        materials: Folder of images in place of the built-in materials; with ``+`` before it, beside them.
    """

    task: str = "PickCube"
    task_kwargs: Mapping[str, Any] = field(default_factory=dict)
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
        channels_of(self.level, self.only)

    @property
    def channels(self) -> tuple[str, ...]:
        """Randomization channels that vary, in their fixed order."""
        return channels_of(self.level, self.only)

    def replace(self, **changes: Any) -> Self:
        """Returns a copy with other values; see :func:`dataclasses.replace`."""
        return replace(self, **changes)

    def to_json(self) -> dict[str, Any]:
        """Returns all fields as JSON values, which :meth:`from_json` takes back."""
        return plain(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Returns the spec of JSON values; what is absent takes its default.

        Raises:
            UnknownNameError: A key is no field.
            ConfigError: A value is out of range.
        """
        known = [item.name for item in fields(cls)]
        for key in values:
            if key not in known:
                raise unknown_name("field of an environment", str(key), known)
        given = dict(values)
        if "cameras" in given:
            given["cameras"] = tuple(given["cameras"])
        return cls(**given)

    @property
    def hash(self) -> str:
        """First 16 hex digits of the SHA-256 of the JSON form: equal for equal environments."""
        text = json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def make_task(self) -> "Task":
        """Returns the task, with its scene changed.

        Raises:
            UnknownNameError: There is no such task, or no such part of its scene.
            ConfigError: An option has a value that it may not have.
        """
        from envs.tasks.make import make_task

        return make_task(self.task, self.task_kwargs, self.scenario)

    def make(
        self,
        num_envs: int = 1,
        *,
        split: str = "train",
        observation: Literal["pixels", "state", "full"] = "pixels",
        actions: Literal["task", "rl"] = "task",
        **runtime: Any,
    ) -> "RoboVerseVectorEnv":
        """Returns ``num_envs`` environments that are stepped together, with a NumPy interface.

        Args:
            num_envs: Number of environments.
            split: ``"train"`` or ``"test"``: which episodes.
            observation: What is observed; see :class:`~envs.vector_env.RoboVerseVectorEnv`.
            actions: The task's own controller or its controller for reinforcement learning.
            **runtime: ``protocol_seed``, ``num_threads``, ``autoreset_mode``.
        """
        from envs.vector_env import RoboVerseVectorEnv

        values: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        task = values.pop("task")
        values["materials"] = self.materials or None
        return RoboVerseVectorEnv(
            task, num_envs, split=split, observation=observation, actions=actions, **values, **runtime
        )

    def make_torch(self, num_envs: int, **runtime: Any) -> "TorchVectorEnv":
        """Returns ``num_envs`` environments with a Torch interface, on the simulator's device.

        Args:
            num_envs: Number of environments.
            **runtime: Options of :class:`~envs.torch_env.TorchVectorEnv` beside the spec's, such as ``seed``,
                ``device``, ``substeps``, ``expert_starts``.
        """
        from envs.torch_env import TorchVectorEnv

        return TorchVectorEnv(
            self.task,
            num_envs,
            simulator=self.simulator,
            task_kwargs=self.task_kwargs,
            simulator_settings=self.simulator_settings,
            scenario=self.scenario,
            **runtime,
        )
