"""Replays recordings of ours in a batch of environments of another simulator, or of the same.

By states, every recorded moment is set and looked at: it tests the handler, the robot's kinematics and
whether the success condition says the same. By controls, the first moment is set, the recorded actions are
given, and physics decides what comes of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from envs.state import State
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.sim2sim.parity.recording import Recording

HOLD_STEPS = 10
"""Steps for which the last action is held: half a second for what lags behind to arrive."""


@dataclass(frozen=True, slots=True)
class Track:
    """What became of one recording.

    Attributes:
        moments: States, one row for each recorded moment: T + 1.
        success: Whether the task was solved, at each moment and while the last action was held; bool (…,).
    """

    moments: State
    success: np.ndarray

    @property
    def solved(self) -> bool:
        """Whether the task was solved at any moment."""
        return bool(self.success.any())


def by_states(env: RoboVerseVectorEnv, recordings: Sequence[Recording]) -> list[Track]:
    """Sets every recorded moment and reads it back, as many at once as the env has environments."""
    moments = _joined([recording.moments for recording in recordings])
    handler, got, success = env.handler, [], []
    for first in range(0, moments.num_envs, env.num_envs):
        rows = list(range(first, min(first + env.num_envs, moments.num_envs)))
        ids = list(range(len(rows)))
        handler.set_states(moments.select(rows).to(handler.device, handler.dtype), ids)
        states = handler.get_states(ids)
        success.append(env.task.success(states).cpu().numpy())
        got.append(states.to("cpu"))
    everything, solved = _joined(got), np.concatenate(success)
    tracks, first = [], 0
    for recording in recordings:
        rows = range(first, first + recording.num_steps + 1)
        tracks.append(Track(everything.select(list(rows)), solved[rows.start : rows.stop]))
        first = rows.stop
    return tracks


def by_controls(env: RoboVerseVectorEnv, recordings: Sequence[Recording]) -> list[Track]:
    """Sets the first moments and gives the recorded actions.

    Raises:
        SimulatorError: if a state is no longer finite.
    """
    tracks = []
    for first in range(0, len(recordings), env.num_envs):
        tracks += _wave(env, recordings[first : first + env.num_envs])
    return tracks


def _wave(env: RoboVerseVectorEnv, recordings: Sequence[Recording]) -> list[Track]:
    everyone = np.arange(len(recordings))
    episodes = [int(recording.metadata["episode"]) for recording in recordings]
    starts = _joined([recording.moments.select([0]) for recording in recordings])
    env.reset_envs(everyone, episodes, starts)
    begun = env.get_states(everyone)
    solved = env.task.success(begun).cpu().numpy()
    moments = [[begun.to("cpu").select([i])] for i in everyone]
    success = [[bool(solved[i])] for i in everyone]
    steps = np.array([recording.num_steps for recording in recordings])
    for step in range(steps.max() + HOLD_STEPS):
        active = np.flatnonzero(step < steps + HOLD_STEPS)
        actions = [recordings[i].actions[min(step, steps[i] - 1)] for i in active]
        result = env.step_envs(active, np.stack(actions))
        states = env.get_states(active).to("cpu")
        for row, i in enumerate(active):
            success[i].append(bool(result.success[row]))
            if step < steps[i]:
                moments[i].append(states.select([row]))
    return [Track(_joined(moments[i]), np.array(success[i])) for i in everyone]


def recorded_success(env: RoboVerseVectorEnv, recording: Recording) -> np.ndarray:
    """Returns what the task says of the recorded moments themselves, bool (T + 1,)."""
    return env.task.success(recording.moments).cpu().numpy()


def _joined(states: Sequence[State]) -> State:
    """Returns the rows of several states as one."""
    flats = [state.flatten() for state in states]
    return State.unflatten({key: torch.cat([flat[key] for flat in flats]) for key in flats[0]})
