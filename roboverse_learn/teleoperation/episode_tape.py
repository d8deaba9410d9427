"""The steps of the episode that runs."""

from typing import Any, NamedTuple

import numpy as np
import torch

from envs.state import State
from roboverse_learn.teleoperation.quality import measure
from roboverse_learn.teleoperation.recording import Recording
from roboverse_learn.teleoperation.station import Station


class Step(NamedTuple):
    """One control step.

    Attributes:
        action: Action of the task, (A,) float32.
        hand: Action of the hand, (7,) float32.
        success: Whether the task is solved after it.
        person: Whether a person acted.
    """

    action: np.ndarray
    hand: np.ndarray
    success: bool
    person: bool


class EpisodeTape:
    """States before each step, and the steps; the end can be taken back."""

    def __init__(self) -> None:
        self._states: list[State] = []
        self._steps: list[Step] = []

    def __len__(self) -> int:
        """Control steps."""
        return len(self._steps)

    @property
    def solved_at(self) -> int | None:
        """Steps until the first success, or None."""
        return next((index + 1 for index, step in enumerate(self._steps) if step.success), None)

    def append(self, before: State, step: Step) -> None:
        """Adds a step, and the state (one row) in which it was taken."""
        self._states.append(before)
        self._steps.append(step)

    def rewind(self, length: int) -> State:
        """Keeps the first steps; returns the state after them."""
        state = self._states[length]
        del self._states[length:], self._steps[length:]
        return state

    def recording(self, station: Station, facts: dict[str, Any]) -> Recording:
        """Returns the episode as a recording.

        Args:
            station: Its environment, in the state after the last step.
            facts: What is known of it otherwise.
        """
        flats = [state.flatten() for state in (*self._states, station.state)]
        states = {key: torch.cat([flat[key] for flat in flats]).double().numpy() for key in flats[0]}
        own = {
            "instruction": station.instruction,
            "initial_state_hash": station.initial_state_hash,
            "scene": station.scene,
            "protocol_seed": station.protocol_seed,
            **measure(states, station.robot, station.control_hz).to_json(),
        }
        return Recording(
            states=states,
            actions=np.stack([step.action for step in self._steps]),
            hand_actions=np.stack([step.hand for step in self._steps]),
            successes=np.array([step.success for step in self._steps], bool),
            interventions=np.array([step.person for step in self._steps], bool),
            facts=own | facts,
        )
