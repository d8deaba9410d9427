"""The env configuration that LeRobot's command line knows as ``roboverse``."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from envs.tasks import TASKS
from envs.vector_env import RoboVerseVectorEnv


class LeRobotVectorEnv(RoboVerseVectorEnv):
    """The batched env with the ``call`` that LeRobot's evaluation asks vector envs by."""

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns what each environment would say to ``name``.

        Raises:
            AttributeError: for anything but ``task``, ``task_description``, ``_max_episode_steps`` and
                ``render``.
        """
        if name == "render":
            return self.render()
        if name == "task_description":
            return tuple(self.instruction(env_id) for env_id in range(self.num_envs))
        if name in ("task", "_max_episode_steps"):
            value = self.task.name if name == "task" else self.task.max_episode_steps
            return (value,) * self.num_envs
        raise AttributeError(f"RoboVerse's vector env has no '{name}' to call.")

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns what each environment has under ``name``, by which LeRobot asks what there is."""
        return self.call(name)


@EnvConfig.register_subclass("roboverse")
@dataclass
class RoboVerseEnvConfig(EnvConfig):
    """Options of ``--env.type=roboverse``; see :class:`envs.vector_env.RoboVerseVectorEnv`.

    Attributes:
        task: Name of a task.
        level: Level of randomization.
        only: One channel to vary instead of a level.
        split: ``"train"`` or ``"test"``.
        simulator: Name of a simulator.
        renderer: Name of a renderer.
        cameras: Names of the cameras that are observed; none is the task's first.
        image_size: Height and width of the pictures.
        fps: Control steps per second.
    """

    task: str | None = "PickCube"
    level: int = 0
    only: str | None = None
    split: str = "test"
    simulator: str = "mujoco"
    renderer: str = "warp"
    cameras: list[str] = dataclasses.field(default_factory=list)
    image_size: int = 256
    fps: int = 20
    features: dict[str, PolicyFeature] = dataclasses.field(default_factory=dict)
    features_map: dict[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        task = TASKS.get(str(self.task))()
        scenario = task.scenario.seen_by(self.cameras, self.image_size)
        joints = (len(scenario.robots[0].joints),)
        self.fps = round(scenario.physics.control_hz)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (len(task.controller.names),)),
            "agent_pos": PolicyFeature(FeatureType.STATE, joints),
        }
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE}
        for camera in scenario.cameras:
            key = f"pixels/{camera.name}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, (camera.height, camera.width, 3))
            self.features_map[key] = f"{OBS_IMAGES}.{camera.name}"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Options of the env beside its task."""
        names = ("level", "only", "split", "simulator", "renderer", "cameras", "image_size")
        return {name: getattr(self, name) for name in names}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
        """Makes one batched env; it steps on native threads, so that ``use_async_envs`` changes nothing."""
        env = LeRobotVectorEnv(str(self.task), n_envs, autoreset_mode="SameStep", **self.gym_kwargs)
        return {self.type: {0: env}}
