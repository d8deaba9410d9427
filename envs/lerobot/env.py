"""Environment configuration, registered as ``roboverse`` in LeRobot's command line."""

from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from envs.lerobot.lazy_env import LazyVectorEnv
from envs.lerobot.spec_options import with_spec_fields
from envs.scenario.changes import merged
from envs.spec import EnvSpec
from envs.tasks.protocols import PROTOCOLS
from envs.tasks.suites import SUITES, suite_tasks
from envs.vector_env import RoboVerseVectorEnv

_SpecOptions = with_spec_fields(EnvConfig)


@EnvConfig.register_subclass("roboverse")
@dataclass
class RoboVerseEnvConfig(_SpecOptions):
    """Options of ``--env.type=roboverse``: the fields of :class:`~envs.spec.EnvSpec`, and these.

    Attributes:
        task: A task, or a suite, of which every task is evaluated.
        protocol: Another benchmark's own protocol, such as ``libero``; what is given beside it wins.
        split: ``"train"``, ``"validation"`` or ``"test"``: which episodes.
        fps: Control steps per second; follows from the task.
    """

    protocol: str = ""
    split: str = "test"
    fps: int = 20
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        task = self.spec.make_task()
        scenario = task.scenario.seen_by(self.spec.cameras, self.spec.image_size)
        self.fps = round(scenario.physics.control_hz)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (len(task.controller.names),)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(task.state_names),)),
        }
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE}
        for camera in scenario.cameras:
            key = f"pixels/{camera.name}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, (camera.height, camera.width, 3))
            self.features_map[key] = f"{OBS_IMAGES}.{camera.name}"

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that are evaluated, one unless ``task`` is a suite."""
        return suite_tasks(self.task) if self.task in SUITES else (self.task,)

    @property
    def spec(self) -> EnvSpec:
        """The environment of the first task."""
        values = {item.name: getattr(self, item.name) for item in fields(EnvSpec)}
        if self.protocol:
            given = {key: value for key, value in values.items() if value}
            values |= merged(PROTOCOLS.get(self.protocol).env, given)
        return EnvSpec.from_json(values | {"task": self.tasks[0]})

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Options of ``gymnasium.make`` beside the task."""
        options = self.spec.to_json() | {"split": self.split}
        del options["task"]
        return options

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """Makes a batched environment for each task; ``use_async_envs`` has no effect: threads are native.

        Those of a suite are made when they are used, in its order; numbers of LIBERO's tasks are LIBERO's.
        """

        def make(task: str) -> RoboVerseVectorEnv:
            spec = self.spec.replace(task=task)
            return spec.make(n_envs, split=self.split, autoreset_mode="SameStep")

        if self.task not in SUITES:
            return {self.type: {0: make(self.task)}}
        each = {number: LazyVectorEnv(partial(make, task), n_envs) for number, task in enumerate(self.tasks)}
        return {self.task: each}
