"""A session in a scene that another program steps: it says what to do, and does nothing itself."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, override

import numpy as np

from envs.lerobot.robot import RoboVerseRobot
from envs.state import State
from roboverse_learn.teleoperation.episode_book import EpisodeBook
from roboverse_learn.teleoperation.protocol import Button, Move, Press, View
from roboverse_learn.teleoperation.recording import Recording
from roboverse_learn.teleoperation.session import Session
from roboverse_learn.teleoperation.station import Station

_LIMIT_S = 600.0
"""Simulated seconds after which the arm is held until the person presses start: LeRobot ends episodes."""

_OURS = frozenset({Button.START, Button.PAUSE})
"""Buttons that have a meaning here; what is kept, and when an episode ends, LeRobot decides."""


class LentStation(Station):
    """A station whose steps are asked for and not made.

    Attributes:
        asked: The action of the last tick, (A,); None where nothing moves.
    """

    asked: np.ndarray | None = None

    def __init__(self, robot: RoboVerseRobot) -> None:
        self._lender = robot
        super().__init__(robot.env, 0)

    @override
    def start(self, episode: int) -> None:
        self._read()

    @override
    def step(self, action: np.ndarray) -> tuple[bool, bool]:
        self.asked = action
        return self._lender.solved_at is not None, False

    @override
    def restore(self, state: State) -> None:
        self._read()

    def look(self) -> None:
        """Reads where the other program has brought the scene."""
        self._read()


class _NoBook(EpisodeBook):
    """Keeps no episodes."""

    def __init__(self, robot: RoboVerseRobot) -> None:
        self._robot = robot

    @property
    @override
    def kept(self) -> int:
        return self._robot.number

    @property
    def wanted(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The present episode; LeRobot decides how many there will be."""
        return self._robot.number + 1

    @override
    def take(self) -> int | None:
        return self._robot.episode

    @override
    def give_back(self, episode: int, *, skip: bool = False) -> None:
        """Nothing is given back."""

    @override
    def add(self, recording: Recording) -> Path:
        return Path()


class LentSession(Session):
    """The session of a ``roboverse`` robot of LeRobot.

    Args:
        robot: The robot, connected.
    """

    station: LentStation

    def __init__(self, robot: RoboVerseRobot) -> None:
        super().__init__(LentStation(robot), _NoBook(robot), limit_s=_LIMIT_S)
        self._robot, self._number = robot, robot.number
        self._start()

    @override
    def submit(self, message: Move | Press | View) -> None:
        if isinstance(message, Press) and message.button not in _OURS:
            self.note, self.version = "LeRobot keeps and ends episodes: see its keys.", self.version + 1
            return
        super().submit(message)

    def next_action(self) -> np.ndarray | None:
        """Returns the action of this control step, (A,) float32; None holds the arm where its targets are."""
        if self._robot.number != self._number:
            self._number = self._robot.number
            self._load(self._robot.episode)
            self.note = "The next episode."
            self._start()
        self.station.look()
        self.station.asked = None
        self.tick()
        return self.station.asked

    def page_facts(self, images: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Returns what the page receives first, as JSON values.

        Args:
            images: Camera to its image now, (H, W, 3).
        """
        height, width, _ = next(iter(images.values())).shape
        return {
            "task": self._robot.config.task,
            "control_hz": self.station.control_hz,
            "cameras": list(images),
            "size": [width, height],
            "delta_m": self.station.controller.delta_m,
            "delta_rad": self.station.controller.delta_rad,
        }
