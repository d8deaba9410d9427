"""Replays our recordings in another simulator, or in the same one.

By states, every recorded state is set and read back: it tests the simulator's states, the robot's kinematics
and whether the success condition agrees. By controls, the first state is set, the recorded actions are given,
and physics decides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from envs.playback import ReplayActor, set_and_judge
from envs.rollout import in_order, rollout
from envs.state import State, concatenated
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.dataset.recording import Recording


@dataclass(frozen=True, slots=True)
class Track:
    """The replay of one recording of T control steps.

    Attributes:
        states: Replayed states, one row for each recorded one: T + 1.
        success: Whether the task is solved in each of them and while the last action is held; bool (…,).
    """

    states: State
    success: np.ndarray

    @property
    def solved(self) -> bool:
        """Whether the task is solved at any step."""
        return bool(self.success.any())


def by_states(env: RoboVerseVectorEnv, recordings: Sequence[Recording]) -> list[Track]:
    """Sets every recorded state and reads it back, as many at once as the env has environments."""
    recorded = concatenated([recording.states for recording in recordings])
    parts, success = [], []
    for first in range(0, recorded.num_envs, env.num_envs):
        rows = range(first, min(first + env.num_envs, recorded.num_envs))
        found, solved = set_and_judge(env, range(len(rows)), recorded.select(rows))
        parts.append(found.to("cpu"))
        success.append(solved)
    states, solved = concatenated(parts), np.concatenate(success)
    tracks, first = [], 0
    for recording in recordings:
        end = first + recording.num_steps + 1
        tracks.append(Track(states.select(range(first, end)), solved[first:end]))
        first = end
    return tracks


def by_controls(env: RoboVerseVectorEnv, recordings: Sequence[Recording]) -> list[Track]:
    """Sets the first states and gives the recorded actions, the last of them for a while longer.

    Raises:
        SimulatorError: if a state is no longer finite.
    """
    starts = [recording.states.select([0]) for recording in recordings]
    actor = ReplayActor(starts, [recording.actions for recording in recordings])
    episodes = [int(recording.metadata["episode"]) for recording in recordings]
    tracks = []
    for recording, episode in zip(
        recordings, in_order(rollout(env, actor, episodes, record=["states"])), strict=True
    ):
        states = episode.states.select(range(recording.num_steps + 1))
        begun = states.select([0]).to(env.handler.device, env.handler.dtype)
        first = env.task.success(begun).cpu().numpy()
        tracks.append(Track(states, np.concatenate([first, episode.successes])))
    return tracks


def recorded_success(env: RoboVerseVectorEnv, recording: Recording) -> np.ndarray:
    """Returns the success of the recorded states themselves, bool (T + 1,)."""
    return env.task.success(recording.states).cpu().numpy()
