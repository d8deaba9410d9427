"""Episodes of the scripted expert, recorded as a policy would see them."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from envs.randomization import channel_rng
from envs.tasks.plan_following import TAIL_STEPS
from envs.tasks.planner import Planner
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


class _Recording:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.plan: deque[np.ndarray] = deque()
        self.actions: list[np.ndarray] = []
        self.steps_left: int | None = None
        self.observations: list[dict[str, np.ndarray]] = []
        self.states: list[dict[str, np.ndarray]] = []
        self.rewards: list[float] = []
        self.success = False

    def note(self, success: bool) -> None:
        """Notes the outcome of a step; the first success leaves a few steps more."""
        if self.steps_left is not None:
            self.steps_left -= 1
        elif success:
            self.success = True
            self.steps_left = TAIL_STEPS


class ExpertRunner:
    """Rolls the expert out in a batched env.

    Args:
        env: The env; with pixel observations the pictures are recorded.
        planner: Asked for plans; the task's by default.
    """

    def __init__(self, env: RoboVerseVectorEnv, planner: Planner | None = None) -> None:
        self._env = env
        self._planner = env.task.planner if planner is None else planner

    def rollout(self, episodes: Sequence[int]) -> Iterator[Rollout]:
        """Yields one rollout per episode, in order, as many at once as the env has environments."""
        for first in range(0, len(episodes), self._env.num_envs):
            yield from self._wave(np.asarray(episodes[first : first + self._env.num_envs]))

    def _wave(self, episodes: np.ndarray) -> list[Rollout]:
        env = self._env
        everyone = np.arange(len(episodes))
        env.reset_envs(everyone, episodes)
        recordings = [_Recording(channel_rng(env.protocol_seed, "expert", int(e))) for e in episodes]
        self._note_states(recordings, everyone)
        for _ in range(env.task.max_episode_steps):
            active = np.array([i for i in everyone if self._goes_on(int(i), recordings[i])], dtype=np.int64)
            if not len(active):
                break
            observation = env.observe(active)
            for row, env_id in enumerate(active):
                recordings[env_id].observations.append(
                    {key: value[row] for key, value in observation.items()}
                )
                recordings[env_id].actions.append(recordings[env_id].plan.popleft())
            result = env.step_envs(active, np.stack([recordings[i].actions[-1] for i in active]))
            self._note_states(recordings, active)
            for row, env_id in enumerate(active):
                recordings[env_id].rewards.append(float(result.reward[row]))
                recordings[env_id].note(bool(result.success[row]))
        return [self._finish(env_id, recordings[env_id]) for env_id in everyone.tolist()]

    def _goes_on(self, env_id: int, recording: _Recording) -> bool:
        """Returns whether there is another action; asks the expert when its plan is used up."""
        if recording.steps_left == 0:
            return False
        if not recording.plan:
            state = self._env.get_states([env_id]).to("cpu")
            recording.plan.extend(self._planner.plan(state, recording.rng))
        if not recording.plan and recording.success:
            recording.plan.append(recording.actions[-1])
        return bool(recording.plan)

    def _note_states(self, recordings: list[_Recording], env_ids: np.ndarray) -> None:
        states = self._env.get_states(env_ids).to("cpu")
        flat = {key: value.numpy() for key, value in states.flatten().items()}
        for row, env_id in enumerate(env_ids):
            recordings[env_id].states.append({key: value[row] for key, value in flat.items()})

    def _finish(self, env_id: int, recording: _Recording) -> Rollout:
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
            actions=np.stack(recording.actions),
            rewards=np.array(recording.rewards, np.float32),
            images={key.removeprefix(prefix): v for key, v in stacked.items() if key.startswith(prefix)},
            raw={key: np.stack([s[key] for s in recording.states]) for key in recording.states[0]},
        )


def rollout(
    env: RoboVerseVectorEnv, episodes: Sequence[int], planner: Planner | None = None
) -> Iterator[Rollout]:
    """Yields the rollouts of the expert, or of what another planner says, of these episodes, in order."""
    if env.handler.steps_together:
        from envs.experts.batched_rollout import BatchedExpertRunner

        yield from BatchedExpertRunner(env, planner).rollout(episodes)
    else:
        yield from ExpertRunner(env, planner).rollout(episodes)
