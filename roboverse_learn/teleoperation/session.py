"""The state machine of one operator: phases, buttons, motions, and the episode that is recorded.

It uses neither network nor clock: :meth:`Session.tick` is one control step, whoever calls it when.

========= =====================================================================================
phase     what happens in a tick
========= =====================================================================================
ready     nothing: the episode is at its start until *start* is pressed
running   the arm moves and the episode is recorded, from the first motion on
paused    nothing: simulated time stands still, and the episode is kept
over      nothing: there are as many successes as wanted
========= =====================================================================================

While no new motion arrives the arm is held still (after ``HOLD_S``), then the episode is paused (after
``PAUSE_S``): a lost connection costs neither the episode nor idle steps in it. *start* continues.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from envs.tasks.plan_following import TAIL_STEPS
from roboverse_learn.teleoperation.episode_book import EpisodeBook
from roboverse_learn.teleoperation.episode_tape import EpisodeTape, Step
from roboverse_learn.teleoperation.protocol import STILL, Button, Move, Press, View
from roboverse_learn.teleoperation.recording import Mark
from roboverse_learn.teleoperation.station import Station

HOLD_S, PAUSE_S = 0.25, 2.0
"""Seconds without a message after which the arm is held still, and the episode is paused."""

REWIND_S = 1.0
"""Seconds that *undo* takes back while an episode runs."""

MAX_BACKLOG = np.array([0.15] * 3 + [0.6] * 3)
"""Largest motion that is asked for and still to be made, m and rad: a burst does not run on for seconds."""


class Phase(StrEnum):
    """See the module."""

    READY = "ready"
    RUNNING = "running"
    PAUSED = "paused"
    OVER = "over"


class Driver(Protocol):
    """Acts while no person does: a policy.

    Attributes:
        facts: JSON-able: what recordings say of it.
    """

    facts: dict[str, Any]

    def begin(self, episode: int) -> None:
        """Prepares for an episode."""
        ...

    def act(self, station: Station) -> np.ndarray:
        """Returns the next action of the task, (A,) float32."""
        ...


class Session:
    """One operator and one environment.

    Args:
        station: The environment.
        book: Episodes and recordings, shared with other operators.
        limit_s: Simulated seconds after which an episode ends as a failure.
        driver: Acts until the person takes over; None leaves everything to the person.

    Attributes:
        phase: See the module.
        version: Rises whenever what there is to see has changed.
        seq: Number of the newest motion that was applied.
        operator: Name of the person.
        connected: Whether the person is there; an episode that runs is paused where not.
        episode: The present episode of the train split; None where there is nothing left to do.
        acting: ``person`` or ``policy``.
        cameras: Those whose images are shown.
        done: Whether the person has pressed *finish* after the last episode.
    """

    def __init__(
        self, station: Station, book: EpisodeBook, *, limit_s: float = 60.0, driver: Driver | None = None
    ) -> None:
        self.station, self._book, self._driver = station, book, driver
        self._hold_ticks, self._pause_ticks, self._rewind, self._limit = (
            max(1, round(seconds * station.control_hz)) for seconds in (HOLD_S, PAUSE_S, REWIND_S, limit_s)
        )
        self._inbox: deque[Move | Press | View] = deque()
        self._devices: Counter[str] = Counter()
        self._made: list[Path] = []
        self.episode: int | None = None
        self.operator, self.note = "", ""
        self.cameras = station.cameras[:1]
        self.version = self.seq = 0
        self.phase, self.connected, self.done = Phase.READY, False, False
        self._load(self._book.take())

    # -- what others call, from any thread ------------------------------------------------------------

    def submit(self, message: Move | Press | View) -> None:
        """Takes a message of the person, which the next tick acts on."""
        self._inbox.append(message)

    @property
    def has_driver(self) -> bool:
        """Whether there is a policy to correct."""
        return self._driver is not None

    @property
    def step(self) -> int:
        """Control steps of the episode so far."""
        return len(self._tape)

    # -- one control step ----------------------------------------------------------------------------

    def tick(self) -> None:
        """Acts on messages, and advances the episode by one control step where it runs."""
        self._silent += 1
        while self._inbox:
            message = self._inbox.popleft()
            if isinstance(message, Press):
                self._press(message.button)
            elif isinstance(message, View):
                self._look(message.cameras)
            else:
                self._take(message)
        if self.phase is not Phase.RUNNING:
            return
        if not self.connected or self._silent >= self._pause_ticks:
            self._pause("The connection was lost: the episode waits. Press start to continue.")
            return
        self._advance()

    def _look(self, cameras: Sequence[str]) -> None:
        """Shows other cameras; names that there are not are passed over."""
        known = tuple(name for name in cameras if name in self.station.cameras)
        self.cameras = known or self.cameras
        self.version += 1

    def _take(self, move: Move) -> None:
        """Notes a motion; those that come while nothing runs set the gripper alone.

        The gripper follows what changes: a page that repeats its old word, just after a policy has closed the
        gripper or *undo* has, opens nothing.
        """
        self._silent, self._move = 0, move
        if move.gripper is not None and move.gripper != self._said_gripper:
            self._gripper = self._said_gripper = move.gripper
        if self.phase is Phase.RUNNING:
            self._backlog = np.clip(self._backlog + np.array(move.shift), -MAX_BACKLOG, MAX_BACKLOG)
            self._devices[move.device] += move.moves
        self.seq = move.seq

    def _advance(self) -> None:
        state, hand, person = self.station.state, self._hand_action(), self.acting == "person"
        if person:
            grips = abs(hand[-1] - self._rest_gripper) > 0.05
            if not len(self._tape) and not hand[:-1].any() and not grips:
                return  # the clock waits for the first motion
            action = self.station.actions_of(hand)
        else:
            assert self._driver is not None, "only a driver acts in a person's place"
            action, hand = self._driver.act(self.station), np.zeros_like(hand)
        success, failed = self.station.step(action)
        self._tape.append(state, Step(action=action, hand=hand, success=success, person=person))
        self.version += 1
        solved = self._tape.solved_at
        stayed = solved is not None and len(self._tape) - solved >= TAIL_STEPS
        if failed or stayed or len(self._tape) >= self._limit:
            self._close()

    def _hand_action(self) -> np.ndarray:
        """Returns the hand's action (7,); after a success it holds still, so that a policy learns to stay."""
        action = np.zeros(7, np.float32)
        action[6] = self._gripper
        if self._tape.solved_at is not None:
            action[6] = self.station.gripper()
            return action
        limits = np.array([self.station.controller.delta_m] * 3 + [self.station.controller.delta_rad] * 3)
        if self._silent < self._hold_ticks:
            part = np.clip(self._backlog, -limits, limits)
            self._backlog = self._backlog - part
            action[:6] = np.clip(np.array(self._move.rate) + part / limits, -1.0, 1.0)
        return action

    # -- buttons -------------------------------------------------------------------------------------

    def _press(self, button: Button) -> None:
        actions: dict[Button, Callable[[], None]] = {
            Button.START: self._start,
            Button.PAUSE: lambda: self._pause("Paused. Press start to continue."),
            Button.FINISH: self._close,
            Button.DISCARD: self._discard,
            Button.RESET: self._reset,
            Button.UNDO: self._undo,
            Button.TAKEOVER: self._take_over,
        }
        self.version += 1
        actions[button]()

    def _start(self) -> None:
        if self.phase in (Phase.READY, Phase.PAUSED):
            self.phase, self.note = Phase.RUNNING, ""
            self._silent, self._move = 0, Move()

    def _pause(self, note: str) -> None:
        if self.phase is Phase.RUNNING:
            self.phase, self.note = Phase.PAUSED, note
            self._still()
            self.version += 1

    def _discard(self) -> None:
        """Throws the present episode away; the next one is another."""
        if self.phase is Phase.OVER or self.episode is None:
            return
        self._record(Mark.DISCARDED)
        self._book.give_back(self.episode, skip=True)
        self._load(self._book.take())
        self.note = "Discarded."

    def _reset(self) -> None:
        """Throws the present attempt away; the same episode starts again."""
        if self.phase is not Phase.OVER and self.episode is not None:
            self._record(Mark.DISCARDED)
            self._load(self.episode)
            self.note = "The same episode, from its start."

    def _undo(self) -> None:
        """Takes back a second of an episode that runs or waits, or else the newest that was kept."""
        if len(self._tape):
            left = max(len(self._tape) - self._rewind, 0)
            self.station.restore(self._tape.rewind(left))
            self._still()
            self._gripper = self.station.gripper()
            if self.acting == "policy" and self._driver is not None and self.episode is not None:
                self._driver.begin(self.episode)  # its plan was made for a later state
            self.phase, self.note = Phase.PAUSED, "One second taken back. Press start to continue."
        elif self._made:
            path = self._made.pop()
            self._book.discard(path)
            self.note = f"Episode {int(path.name.partition('.')[0])} is discarded."
            if self.phase is Phase.OVER:
                self._load(self._book.take())

    def _take_over(self) -> None:
        if self._driver is not None and self.episode is not None:
            self.acting = "policy" if self.acting == "person" else "person"
            self._still()
            self._gripper = self.station.gripper()
            if self.acting == "policy":
                self._driver.begin(self.episode)

    # -- episodes ------------------------------------------------------------------------------------

    def _load(self, episode: int | None) -> None:
        """Shows the start of an episode; None where there is nothing left to do."""
        self.episode = episode
        self._tape = EpisodeTape()
        self._devices.clear()
        self._said_gripper: float | None = None
        self.version += 1
        self.acting = "person" if self._driver is None else "policy"
        if episode is None:
            self.phase = Phase.OVER
            self._still()
            return
        self.station.start(episode)
        self.phase = Phase.READY
        self._still()
        self._gripper = self._rest_gripper = self.station.gripper()
        if self._driver is not None:
            self._driver.begin(episode)

    def _still(self) -> None:
        """Drops motions that were asked for."""
        self._move, self._backlog, self._silent = Move(rate=STILL), np.zeros(6), 0

    def _close(self) -> None:
        """Keeps the episode with the mark that the task gives it; the next one is ready."""
        self.done = self.phase is Phase.OVER
        if not len(self._tape) or self.episode is None:
            return
        mark = Mark.FAILURE if self._tape.solved_at is None else Mark.SUCCESS
        self._record(mark)
        self._book.give_back(self.episode, skip=True)
        self._load(self._book.take())
        self.note = "Success, kept." if mark is Mark.SUCCESS else "No success: kept apart as a failure."

    def _record(self, mark: Mark) -> None:
        """Writes the episode, if it has begun."""
        if not len(self._tape) or self.episode is None:
            return
        facts = {
            "episode": self.episode,
            "mark": str(mark),
            "operator": self.operator,
            "device": next((name for name, _ in self._devices.most_common(1)), ""),
        }
        if self._driver is not None:
            facts |= self._driver.facts
        path = self._book.add(self._tape.recording(self.station, facts))
        if mark is not Mark.DISCARDED:
            self._made.append(path)

    # -- what there is to see --------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Returns what a page shows, as JSON values."""
        return {
            "phase": str(self.phase),
            "acting": self.acting,
            "step": len(self._tape),
            "seconds": round(len(self._tape) / self.station.control_hz, 2),
            "limit_s": self._limit / self.station.control_hz,
            "success": self._tape.solved_at is not None,
            "instruction": self.station.instruction if self.episode is not None else "",
            "episode": self.episode,
            "hand": self.station.hand(),
            "cameras": list(self.cameras),
            "view_yaw": round(self.station.view_yaw(self.cameras[0]), 4),
            "driver": self._driver is not None,
            "kept": self._book.kept,
            "wanted": self._book.wanted,
            "seq": self.seq,
            "note": self.note,
        }
