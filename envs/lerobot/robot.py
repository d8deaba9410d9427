"""A simulated scene as a ``Robot`` of LeRobot: ``--robot.type=roboverse``."""

import json
import logging
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, override

import numpy as np
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from envs.core.errors import ConfigError
from envs.lerobot.announcements import EpisodeAnnouncements
from envs.lerobot.spec_options import spec_of, with_spec_fields
from envs.spec import EnvSpec

logger = logging.getLogger(__name__)

_TOO_FAST = 1.3
"""Ratio of the loop's rate to the control rate above which the user is warned."""

_TIMED_STEPS = 40
"""Steps after which the loop's rate is looked at."""

_SpecOptions = with_spec_fields(RobotConfig, kw_only=True)


@RobotConfig.register_subclass("roboverse")
@dataclass(kw_only=True)
class RoboVerseRobotConfig(_SpecOptions):
    """Options of ``--robot.type=roboverse``: the fields of :class:`~envs.spec.EnvSpec`, and these.

    Attributes:
        split: ``"train"``, ``"validation"`` or ``"test"``: which episodes.
        episodes: Episodes of the split, one after the other; none takes all, in the split's order.
        outcomes: File that gets a line of JSON for each episode: its index, steps, and whether and when the
            task was solved. Empty writes none.
        reset_s: Simulated seconds from success, or the task's time limit, to the next episode, for commands
            that announce none, such as a rollout. 0 leaves it to announcements.
    """

    split: str = "train"
    episodes: tuple[int, ...] = ()
    outcomes: str = ""
    reset_s: float = 0.0

    def __post_init__(self) -> None:
        """Not LeRobot's check of cameras, which are devices there and names here."""

    @property
    def spec(self) -> EnvSpec:
        """The environment."""
        return spec_of(self)


class RoboVerseRobot(Robot):
    """The robot of a task, in simulation.

    Each :meth:`send_action` is one control step, so LeRobot's loop should run at the control rate, as in
    ``--fps=20``. The scene starts an episode on :meth:`connect` and whenever LeRobot's recorder begins one.

    Args:
        config: Its options.

    Attributes:
        images: Camera to its newest image, (H, W, 3) uint8.
        number: Episodes that were begun before the present one.
        steps: Control steps of the present episode.
        solved_at: Steps after which its task was first solved, or None.
    """

    config_class = RoboVerseRobotConfig
    name = "roboverse"

    def __init__(self, config: RoboVerseRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        task = config.spec.make_task()
        scenario = task.scenario.seen_by(config.cameras, config.image_size)
        self._states = [joint_key(name) for name in task.state_names]
        self._actions = [joint_key(name) for name in task.controller.names]
        self._low, self._high = task.controller.low, task.controller.high
        self._hz = scenario.physics.control_hz
        # LeRobot counts the cameras of a robot to size its image writers; these need no device.
        self.cameras: dict[str, Any] = {camera.name: None for camera in scenario.cameras}
        self._shapes = {camera.name: (camera.height, camera.width, 3) for camera in scenario.cameras}
        self._open: ExitStack | None = None
        self._env: Any = None
        self.number, self.steps, self.solved_at = -1, 0, None
        self.images: dict[str, np.ndarray] = {}
        self._announced, self._began_s = False, 0.0

    # -- what LeRobot reads before it connects ---------------------------------------------------------

    @property
    @override
    def observation_features(self) -> dict[str, Any]:
        return {**dict.fromkeys(self._states, float), **self._shapes}

    @property
    @override
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(self._actions, float)

    @property
    @override
    def is_connected(self) -> bool:
        return getattr(self, "_env", None) is not None

    @property
    @override
    def is_calibrated(self) -> bool:
        return True

    @override
    def calibrate(self) -> None:
        """A simulated robot has nothing to calibrate."""

    @override
    def configure(self) -> None:
        """Everything is an option."""

    # -- the loop --------------------------------------------------------------------------------------

    @override
    def connect(self, calibrate: bool = True) -> None:
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected.")
        with ExitStack() as stack:
            env = self.config.spec.make(1, split=self.config.split)
            stack.callback(env.close)
            stack.callback(self._forget)
            self._env, self._episodes = env, self._chosen(env.split_indices)
            self.begin_episode()
            self._observe()  # the first image compiles the renderer, which would cost the first ticks
            stack.enter_context(EpisodeAnnouncements(self._announce))
            CONNECTED.append(self)
            stack.callback(CONNECTED.remove, self)
            for prepare in ON_CONNECT:
                prepare(self)
            self._open = stack.pop_all()

    def _forget(self) -> None:
        self._env = None

    def _chosen(self, split: np.ndarray) -> list[int]:
        unknown = sorted(set(self.config.episodes) - set(split.tolist()))
        if unknown:
            raise ConfigError(
                f"--robot.episodes={unknown} are not of the {self.config.split} split. Its first ones are "
                f"{split[:5].tolist()}."
            )
        return list(self.config.episodes) or split.tolist()

    @override
    def disconnect(self) -> None:
        self._check_connected()
        self._end_episode()
        assert self._open is not None
        self._open.close()

    @override
    def get_observation(self) -> dict[str, Any]:
        self._check_connected()
        if self._announced or self._is_over():
            self.begin_episode()
        return self._observe()

    def _observe(self) -> dict[str, Any]:
        seen = self._env.observe()
        self.images = {name: seen[f"observation.images.{name}"][0] for name in self._shapes}
        return dict(zip(self._states, seen["observation.state"][0].tolist(), strict=True)) | self.images

    @override
    def send_action(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Steps the scene by one control step; returns the action inside the robot's limits.

        Raises:
            ConfigError: A joint is absent.
        """
        self._check_connected()
        given = {joint_key(name): float(value) for name, value in action.items()}
        missing = [name for name in self._actions if name not in given]
        if missing:
            raise ConfigError(
                f"An action of '{self.config.task}' has {', '.join(self._actions)}; {', '.join(missing)} "
                f"is missing in {', '.join(given) or 'an empty one'}."
            )
        values = np.clip([given[name] for name in self._actions], self._low, self._high).astype(np.float32)
        result = self._env.step_envs([0], values[None])
        self.steps += 1
        if result.success[0] and self.solved_at is None:
            self.solved_at = self.steps
            logger.info("%s: solved after %d steps.", self._words(), self.steps)
        self._watch_rate()
        return dict(zip(self._actions, values.tolist(), strict=True))

    # -- episodes --------------------------------------------------------------------------------------

    @property
    def env(self) -> Any:
        """The environment, of one scene: a :class:`~envs.vector_env.RoboVerseVectorEnv`."""
        self._check_connected()
        return self._env

    @property
    def episode(self) -> int:
        """Index of the present episode in the task's pool."""
        return int(self._env.episodes[0])

    def _is_over(self) -> bool:
        """Whether the scene begins its next episode by itself."""
        if not self.config.reset_s:
            return False
        late = self._env.max_episode_steps if self.solved_at is None else self.solved_at
        return self.steps >= late + round(self.config.reset_s * self._hz)

    def begin_episode(self) -> None:
        """Starts the next episode; the last one is written down."""
        self._end_episode()
        self._announced = False
        self.number += 1
        index = self._episodes[self.number % len(self._episodes)]
        self._env.reset_envs(np.array([0]), np.array([index]))
        self.steps, self.solved_at = 0, None
        logger.info("%s begins: %s", self._words(), self._env.instruction(0))

    def _end_episode(self) -> None:
        if not self.steps or not self.config.outcomes:
            return
        line = {"episode": self.episode, "steps": self.steps, "solved_at": self.solved_at}
        path = Path(self.config.outcomes)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line | {"success": self.solved_at is not None}) + "\n")
        self.steps = 0

    def _announce(self) -> None:
        """An episode is announced; nothing was done yet in the one that runs, if it is fresh."""
        self._announced = self.steps > 0

    def _words(self) -> str:
        return f"{self.config.task}, episode {self.episode}"

    def _watch_rate(self) -> None:
        """Warns of a loop that is faster than the scene's control rate, which plays it too fast."""
        if self.steps == 1:
            self._began_s = time.perf_counter()
        if self.steps != _TIMED_STEPS or self.number:
            return
        rate = (self.steps - 1) / max(time.perf_counter() - self._began_s, 1e-9)
        if rate > _TOO_FAST * self._hz:
            logger.warning(
                "The loop runs at %.0f Hz, and %s at %.0f: it passes %.1f times as fast as it should. Give "
                "--fps=%.0f.",
                *(rate, self.config.task, self._hz, rate / self._hz, self._hz),
            )

    def _check_connected(self) -> None:
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first.")


CONNECTED: list[RoboVerseRobot] = []
"""Robots of this process that are connected: a teleoperator acts on what the newest one shows."""

ON_CONNECT: "list[Callable[[RoboVerseRobot], None]]" = []
"""Functions that are called with each robot that connects, before the command's loop begins."""


def joint_key(name: str) -> str:
    """Returns the name of a joint as LeRobot writes it: without ``/``, and with ``.pos`` at the end.

    ``lerobot-rollout`` passes a policy nothing but ``.pos`` and ``.vel``.
    """
    return f"{name.removesuffix('.pos').replace('/', '_')}.pos"
