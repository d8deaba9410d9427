"""Teleoperators of LeRobot that act in a simulated scene: the task's expert, and recorded actions."""

import logging
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import Any, override

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceNotConnectedError

from envs.core.errors import ConfigError
from envs.lerobot.robot import CONNECTED, ON_CONNECT, RoboVerseRobot, joint_key
from envs.randomization import channel_rng
from envs.tasks.plan_following import TAIL_STEPS

logger = logging.getLogger(__name__)


class SceneTeleoperator(Teleoperator):
    """A teleoperator that acts in the scene of the ``roboverse`` robot of the same process."""

    def __init__(self, config: TeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self._connected = False
        self._plan: deque[np.ndarray] = deque()
        self._last: np.ndarray | None = None
        self._number = self._steps = -1

    @property
    @override
    def action_features(self) -> dict[str, Any]:
        return CONNECTED[-1].action_features if CONNECTED else {}

    @property
    @override
    def feedback_features(self) -> dict[str, Any]:
        return {}

    @property
    @override
    def is_connected(self) -> bool:
        return self._connected

    @property
    @override
    def is_calibrated(self) -> bool:
        return True

    @override
    def connect(self, calibrate: bool = True) -> None:
        self._connected = True
        ON_CONNECT.append(self.prepare)
        if CONNECTED:  # a rollout connects its robot first
            self.prepare(CONNECTED[-1])

    @override
    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    @override
    def configure(self) -> None:
        """Everything is an option."""

    @override
    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """No feedback is felt."""

    @override
    def disconnect(self) -> None:
        self._connected = False
        if self.prepare in ON_CONNECT:
            ON_CONNECT.remove(self.prepare)

    @override
    def get_action(self) -> dict[str, Any]:
        """Returns the next action of the present episode; the last one is held when all is done.

        Raises:
            DeviceNotConnectedError: No ``roboverse`` robot is connected.
        """
        if not CONNECTED:
            raise DeviceNotConnectedError(
                f"--teleop.type={self.config.type} acts in a simulated scene. Give --robot.type=roboverse."
            )
        if not self._connected:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first.")
        robot = CONNECTED[-1]
        if robot.number != self._number:
            self._number, self._last = robot.number, None
            self._plan.clear()
            self.begin(robot)
        if robot.steps != self._steps:  # another has acted meanwhile, as a policy between two corrections
            self._plan.clear()
        self._steps = robot.steps + 1
        if self.is_over(robot):
            self._plan.clear()
        elif not self._plan:
            self._plan.extend(self.plan(robot))
        if self._plan:
            self._last = self._plan.popleft()
        elif self._last is None:
            self._last = held(robot)
        return dict(zip(robot.action_features, self._last.tolist(), strict=True))

    def is_over(self, robot: RoboVerseRobot) -> bool:
        """Whether the last action is held from now on."""
        del robot
        return False

    def prepare(self, robot: RoboVerseRobot) -> None:
        """Does what takes long, before the first tick of LeRobot's loop."""
        del robot

    def begin(self, robot: RoboVerseRobot) -> None:
        """Prepares for an episode that has just begun."""
        del robot

    @abstractmethod
    def plan(self, robot: RoboVerseRobot) -> np.ndarray:
        """Returns the next actions (T, A) of a scene; T = 0 holds the last one."""


def held(robot: RoboVerseRobot) -> np.ndarray:
    """Returns the action that leaves a scene's robot where its targets are, (A,)."""
    entity = next(iter(robot.env.get_states([0]).robots.values()))
    targets = entity.joint_pos if entity.joint_target is None else entity.joint_target
    if targets.shape[1] != len(robot.action_features):
        return np.zeros(len(robot.action_features), np.float32)
    return targets[0].cpu().numpy().astype(np.float32)


@TeleoperatorConfig.register_subclass("roboverse_expert")
@dataclass(kw_only=True)
class RoboVerseExpertConfig(TeleoperatorConfig):
    """Options of ``--teleop.type=roboverse_expert``, which has none."""


class RoboVerseExpert(SceneTeleoperator):
    """The task's scripted expert: the same actions as ``roboverse collect`` records in that episode."""

    config_class = RoboVerseExpertConfig
    name = "roboverse_expert"

    @override
    def prepare(self, robot: RoboVerseRobot) -> None:
        task = robot.env.task
        if not task.has_expert:
            raise ConfigError(
                f"{task.name} has no scripted expert. Give another --teleop.type, or another --robot.task."
            )
        self._planner = task.planner

    @override
    def begin(self, robot: RoboVerseRobot) -> None:
        self._rng = channel_rng(robot.env.protocol_seed, "expert", robot.episode)

    @override
    def is_over(self, robot: RoboVerseRobot) -> bool:
        ended = robot.solved_at is not None and robot.steps >= robot.solved_at + TAIL_STEPS
        return ended or robot.steps >= robot.env.max_episode_steps

    @override
    def plan(self, robot: RoboVerseRobot) -> np.ndarray:
        return self._planner.plan(robot.env.get_states([0]), self._rng)


@TeleoperatorConfig.register_subclass("roboverse_replay")
@dataclass(kw_only=True)
class RoboVerseReplayConfig(TeleoperatorConfig):
    """Options of ``--teleop.type=roboverse_replay``.

    Attributes:
        path: Folder of a LeRobotDataset.
        episode: Episode that is replayed first; the next one follows with the scene's next episode.
    """

    path: str = ""
    episode: int = 0

    def __post_init__(self) -> None:
        if not self.path:
            raise ConfigError("--teleop.type=roboverse_replay needs --teleop.path=<folder of a dataset>.")


class RoboVerseReplay(SceneTeleoperator):
    """The actions of a dataset, recorded by ``roboverse collect`` or ``lerobot-record``."""

    config_class = RoboVerseReplayConfig
    name = "roboverse_replay"

    def __init__(self, config: RoboVerseReplayConfig) -> None:
        super().__init__(config)
        self._path, self._first = config.path, config.episode

    @override
    def prepare(self, robot: RoboVerseRobot) -> None:
        self._recorded = recorded_actions(self._path, list(robot.action_features))
        self._check(self._first)

    @override
    def begin(self, robot: RoboVerseRobot) -> None:
        self._check(self._first + robot.number)
        self._actions = self._recorded[self._first + robot.number]

    @override
    def plan(self, robot: RoboVerseRobot) -> np.ndarray:
        return self._actions[robot.steps :]

    def _check(self, episode: int) -> None:
        if not 0 <= episode < len(self._recorded):
            raise ConfigError(
                f"Episode {episode} of '{self._path}' was requested, which has {len(self._recorded)}: 0 to "
                f"{len(self._recorded) - 1}."
            )


def recorded_actions(path: str, keys: list[str]) -> list[np.ndarray]:
    """Returns the actions (T, A) of each episode of a LeRobotDataset, in the order of ``keys``.

    Raises:
        ConfigError: Its actions have other names.
    """
    from lerobot.datasets import LeRobotDataset

    dataset = LeRobotDataset("local/replayed", root=path, episodes=None, video_backend="pyav")
    names = [joint_key(name) for name in dataset.features["action"]["names"]]
    if sorted(names) != sorted(keys):
        raise ConfigError(
            f"The actions of '{path}' are {', '.join(names)}, and the robot's are {', '.join(keys)}. Give "
            "the --robot.task and --robot.robot that it was recorded with."
        )
    rows = dataset.hf_dataset.with_format("numpy", columns=["episode_index", "action"])
    episodes = np.asarray(rows["episode_index"][:])
    actions = np.stack(rows["action"][:])[:, [names.index(key) for key in keys]].astype(np.float32)
    return [actions[episodes == episode] for episode in range(dataset.num_episodes)]
