"""Episodes of the expert in a simulator that steps all of its environments together.

What is recorded stays on the simulator's device, as it was drawn, until an episode is asked for.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from envs.experts.rollout import Rollout
from envs.randomization import channel_rng
from envs.state import State
from envs.tasks.plan_following import PlanFollower
from envs.tasks.planner import Planner
from envs.vector_env import RoboVerseVectorEnv


class BatchedExpertRunner:
    """Rolls out as many experts at once as the env has environments.

    An episode is what :class:`envs.experts.rollout.ExpertRunner` makes of it. An environment whose episode
    is over holds still until the others are done, for stopping it costs more than stepping it.

    Args:
        env: The env, whose handler draws into tensors; with pixel observations the pictures are recorded.
        planner: Asked for plans; the task's by default.
    """

    def __init__(self, env: RoboVerseVectorEnv, planner: Planner | None = None) -> None:
        self._env = env
        self._planner = env.task.planner if planner is None else planner
        self._robot = env.scenario.robots[0].name

    def rollout(self, episodes: Sequence[int]) -> Iterator[Rollout]:
        """Yields one rollout per episode, in order, as many at once as the env has environments."""
        for first in range(0, len(episodes), self._env.num_envs):
            yield from self._wave(np.asarray(episodes[first : first + self._env.num_envs]))

    def _wave(self, episodes: np.ndarray) -> Iterator[Rollout]:
        env, everyone = self._env, np.arange(len(episodes))
        env.reset_envs(everyone, episodes)
        progress = PlanFollower(
            [channel_rng(env.protocol_seed, "expert", int(e)) for e in episodes], self._planner
        )
        film = _Film(self._states())
        for _ in range(env.task.max_episode_steps):
            active = progress.active(film.states[-1].state)
            if not len(active):
                break
            film.draw(env, active)
            result = env.step_envs(everyone, progress.next_actions())
            film.states.append(self._states())
            progress.record(active, result.success, result.reward)
        film.cut()
        for env_id in everyone.tolist():
            yield self._rollout(env_id, progress, film)

    def _states(self) -> "_FlatStates":
        return _FlatStates(self._env.get_states())

    def _rollout(self, env_id: int, progress: PlanFollower, film: "_Film") -> Rollout:
        steps = int(progress.lengths[env_id])
        raw = film.raw(env_id, steps)
        return Rollout(
            episode=int(self._env.episodes[env_id]),
            success=bool(progress.success[env_id]),
            instruction=self._env.instruction(env_id),
            initial_state_hash=self._env.initial_state_hash(env_id),
            observation_state=raw[f"robots/{self._robot}/joint_pos"][:-1].astype(np.float32),
            actions=np.stack([actions[env_id] for actions in progress.history[:steps]]),
            rewards=np.array([rewards[env_id] for rewards in progress.rewards[:steps]], np.float32),
            images=film.pictures(env_id, steps),
            raw=raw,
        )


class _FlatStates:
    """The states of all environments at one moment, moved to the CPU in one piece.

    Attributes:
        columns: Key of a flattened state to its columns in ``numbers`` and its shape.
        numbers: (N, D) float64.
    """

    def __init__(self, state: State) -> None:
        flat = state.flatten()
        widths = [value[0].numel() for value in flat.values()]
        ends = np.cumsum(widths)
        shapes = [value.shape[1:] for value in flat.values()]
        self.columns = {
            key: (slice(int(end) - width, int(end)), shape)
            for key, width, end, shape in zip(flat, widths, ends, shapes, strict=True)
        }
        whole = torch.cat([value.flatten(1) for value in flat.values()], dim=1)
        self.numbers = whole.cpu().double().numpy()

    @property
    def state(self) -> State:
        """The state again, in float64 on the CPU."""
        numbers = torch.from_numpy(self.numbers)
        return State.unflatten(
            {
                k: numbers[:, columns].view(len(numbers), *shape)
                for k, (columns, shape) in self.columns.items()
            }
        )


@dataclass(slots=True)
class _Frame:
    """What those who acted at one step saw: their ids in order, and camera to pictures (n, H, W, 3)."""

    env_ids: np.ndarray
    pictures: dict[str, Tensor]


class _Film:
    """Pictures before each step, on the device, and states before each step and after the last."""

    def __init__(self, first: _FlatStates) -> None:
        self.states = [first]
        self._frames: list[_Frame] = []

    def draw(self, env: RoboVerseVectorEnv, active: np.ndarray) -> None:
        """Draws those who act."""
        if env.observation == "pixels":
            pictures = env.handler.render_tensors(env.handler.snapshot(active))
            self._frames.append(_Frame(active, {name: kinds["rgb"] for name, kinds in pictures.items()}))

    def cut(self) -> None:
        """Ends the recording."""
        self._numbers = np.stack([moment.numbers for moment in self.states])

    def raw(self, env_id: int, steps: int) -> dict[str, np.ndarray]:
        """Returns one environment's flattened states, each (steps + 1, …) float64."""
        numbers = self._numbers[: steps + 1, env_id]
        return {
            key: numbers[:, columns].reshape(steps + 1, *shape)
            for key, (columns, shape) in self.states[0].columns.items()
        }

    def pictures(self, env_id: int, steps: int) -> dict[str, np.ndarray]:
        """Returns one environment's pictures, camera to (steps, H, W, 3) uint8."""
        frames = self._frames[:steps]
        rows = [int(np.searchsorted(frame.env_ids, env_id)) for frame in frames]
        cameras = frames[0].pictures if frames else ()
        return {
            name: torch.stack([f.pictures[name][row] for f, row in zip(frames, rows, strict=True)])
            .cpu()
            .numpy()
            for name in cameras
        }
