"""Episodes of the scripted expert, recorded as a policy would see them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from envs.experts.ik import PathFollower
from envs.randomization import channel_rng
from envs.vector_env import RoboVerseVectorEnv


@dataclass(frozen=True, slots=True)
class Rollout:
    """One recorded episode of T control steps.

    Attributes:
        episode: Index in the pool of episodes.
        success: Whether the task was solved; recording goes on for a few steps after that.
        instruction: What the expert was told.
        initial_state_hash: See :meth:`envs.vector_env.RoboVerseVectorEnv.initial_state_hash`.
        observation_state: Joint positions before each step, (T, J) float32.
        actions: Joint targets of each step, (T, J) float32: exactly what the simulator was given.
        rewards: Reward of each step, (T,) float32.
        images: Camera to its pictures before each step, (T, H, W, 3) uint8.
        raw: Flattened states before each step and after the last, each (T + 1, …) float64; see
            :meth:`envs.state.State.flatten`.
    """

    episode: int
    success: bool
    instruction: str
    initial_state_hash: str
    observation_state: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    images: dict[str, np.ndarray]
    raw: dict[str, np.ndarray]


TAIL_STEPS = 5
"""Steps that are recorded after success, so that a policy learns to stay where it is."""


class _Recording:
    def __init__(self, plan: np.ndarray) -> None:
        self.plan = plan
        self.steps_left = len(plan)
        self.observations: list[dict[str, np.ndarray]] = []
        self.states: list[dict[str, np.ndarray]] = []
        self.rewards: list[float] = []
        self.success = False

    def note(self, success: bool, step: int) -> None:
        """Notes the outcome of a step; the first success leaves a few steps more."""
        if success and not self.success:
            self.success = True
            self.steps_left = min(self.steps_left, step + 1 + TAIL_STEPS)


class ExpertRunner:
    """Plans and rolls out the expert in a batched env.

    Args:
        env: The env; with pixel observations the pictures are recorded.
    """

    def __init__(self, env: RoboVerseVectorEnv) -> None:
        self._env = env
        self._follower = PathFollower(env.scenario.robots[0], env.control_hz)

    def plan(self, env_id: int) -> np.ndarray:
        """Returns joint targets (T, J) float32 for the episode that has just begun in ``env_id``."""
        state = self._env.get_states([env_id])
        robot = state.robots[self._env.scenario.robots[0].name]
        rng = channel_rng(self._env.protocol_seed, "expert", int(self._env.episodes[env_id]))
        waypoints = self._env.task.expert(state, rng)
        return self._follower.joint_targets(robot.joint_pos[0].numpy(), waypoints).astype(np.float32)

    def rollout(self, episodes: Sequence[int]) -> Iterator[Rollout]:
        """Yields one rollout per episode, in order, as many at once as the env has environments."""
        for first in range(0, len(episodes), self._env.num_envs):
            yield from self._wave(np.asarray(episodes[first : first + self._env.num_envs]))

    def _wave(self, episodes: np.ndarray) -> list[Rollout]:
        env = self._env
        everyone = np.arange(len(episodes))
        env.reset_envs(everyone, episodes)
        recordings = [_Recording(self.plan(env_id)) for env_id in everyone.tolist()]
        active = everyone
        self._note_states(recordings, active)
        for step in range(env.task.max_episode_steps):
            active = np.array([i for i in active if step < recordings[i].steps_left], dtype=np.int64)
            if not len(active):
                break
            observation = env.observe(active)
            for row, env_id in enumerate(active):
                recordings[env_id].observations.append(
                    {key: value[row] for key, value in observation.items()}
                )
            result = env.step_envs(active, np.stack([recordings[i].plan[step] for i in active]))
            self._note_states(recordings, active)
            for row, env_id in enumerate(active):
                recordings[env_id].rewards.append(float(result.reward[row]))
                recordings[env_id].note(bool(result.success[row]), step)
        return [self._finish(env_id, recordings[env_id]) for env_id in everyone.tolist()]

    def _note_states(self, recordings: list[_Recording], env_ids: np.ndarray) -> None:
        flat = {key: value.numpy() for key, value in self._env.get_states(env_ids).flatten().items()}
        for row, env_id in enumerate(env_ids):
            recordings[env_id].states.append({key: value[row] for key, value in flat.items()})

    def _finish(self, env_id: int, recording: _Recording) -> Rollout:
        steps = len(recording.observations)
        prefix = "observation.images."
        stacked = {
            key: np.stack([o[key] for o in recording.observations]) for key in recording.observations[0]
        }
        return Rollout(
            episode=int(self._env.episodes[env_id]),
            success=recording.success,
            instruction=self._env.instruction(env_id),
            initial_state_hash=self._env.initial_state_hash(env_id),
            observation_state=stacked["observation.state"],
            actions=recording.plan[:steps],
            rewards=np.array(recording.rewards, np.float32),
            images={key.removeprefix(prefix): v for key, v in stacked.items() if key.startswith(prefix)},
            raw={key: np.stack([s[key] for s in recording.states]) for key in recording.states[0]},
        )


def rollout(env: RoboVerseVectorEnv, episodes: Sequence[int]) -> Iterator[Rollout]:
    """Yields the expert's rollouts of these episodes, in order."""
    yield from ExpertRunner(env).rollout(episodes)
