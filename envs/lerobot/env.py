"""Environment configuration, registered as ``roboverse`` in LeRobot's command line."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from envs.lerobot.spec_options import spec_of, with_spec_fields
from envs.spec import EnvSpec

_SpecOptions = with_spec_fields(EnvConfig)


@EnvConfig.register_subclass("roboverse")
@dataclass
class RoboVerseEnvConfig(_SpecOptions):
    """Options of ``--env.type=roboverse``: the fields of :class:`~envs.spec.EnvSpec`, and these.

    Attributes:
        split: ``"train"`` or ``"test"``: which episodes.
        fps: Control steps per second; follows from the task.
    """

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
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(scenario.robots[0].joints),)),
        }
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE}
        for camera in scenario.cameras:
            key = f"pixels/{camera.name}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, (camera.height, camera.width, 3))
            self.features_map[key] = f"{OBS_IMAGES}.{camera.name}"

    @property
    def spec(self) -> EnvSpec:
        """The environment."""
        return spec_of(self)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Options of ``gymnasium.make`` beside the task."""
        options = self.spec.to_json() | {"split": self.split}
        del options["task"]
        return options

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
        """Makes one batched environment; its threads are native, so ``use_async_envs`` has no effect."""
        env = self.spec.make(n_envs, split=self.split, autoreset_mode="SameStep")
        return {self.type: {0: env}}
