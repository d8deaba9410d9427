"""Runs a policy on an env: (policy, env, episodes) to one record per episode.

Every env works through episodes on its own and starts the next one as soon as its own is over. An env
is asked for an observation, and so renders, only when the policy needs one: before a chunk of actions,
and for the few steps before it that a policy with a history looks at. What happens in an episode
depends on the episode alone, never on how many envs run beside it.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol
from zlib import crc32

import numpy as np

from benchmark.protocol import Cell
from benchmark.protocol import Protocol as EvaluationProtocol
from benchmark.provenance import package_versions
from benchmark.records import EpisodeRecord
from envs.core.errors import CheckpointError, ConfigError, SimulatorError
from policies.base import Observation, Policy

if TYPE_CHECKING:
    import torch

OnEpisode = Callable[[EpisodeRecord], None]


class EvaluatedEnv(Protocol):
    """What the runner asks of a batched env."""

    num_envs: int
    simulator: str
    renderer: str
    channels: tuple[str, ...]
    not_shown: tuple[str, ...]
    split_indices: np.ndarray
    task: Any
    single_action_space: Any

    # Every ``env_ids`` is sorted and without repetition.
    def reset_envs(self, env_ids: np.ndarray, episodes: np.ndarray) -> None:
        """Starts these episodes in these envs."""
        ...

    def observe(self, env_ids: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the observation of these envs now; only this renders."""
        ...

    def step_envs(self, env_ids: np.ndarray, actions: np.ndarray) -> Any:
        """Steps these envs; returns reward, terminated, truncated and success, each (n,)."""
        ...

    def initial_state_hash(self, env_id: int) -> str:
        """Returns the hash of the initial state and appearance of the env's episode."""
        ...

    def close(self) -> None:
        """Frees the simulator."""
        ...


@dataclass(slots=True)
class _Slot:
    """One env at work: its episode, what the policy has seen of it, and the actions still to take."""

    episode: int
    state_hash: str
    generator: "torch.Generator"
    history: deque[Observation]
    actions: deque[np.ndarray] = field(default_factory=deque)
    length: int = 0
    episode_return: float = 0.0
    wall_time_s: float = 0.0


def evaluate(
    policy: Policy,
    make_env: Callable[[Cell], EvaluatedEnv],
    protocol: EvaluationProtocol,
    *,
    policy_name: str,
    on_episode: OnEpisode | None = None,
    on_cell: Callable[[Cell, EvaluatedEnv, list[EpisodeRecord]], None] | None = None,
    known: Mapping[Cell, Sequence[EpisodeRecord]] | None = None,
) -> list[EpisodeRecord]:
    """Evaluates a policy on every cell of a protocol.

    Args:
        policy: The policy.
        make_env: Builds the env of a cell; it is closed when its cell is done.
        protocol: What to evaluate.
        policy_name: Name of the policy in the records.
        on_episode: Called with every record as soon as its episode is over.
        on_cell: Called when a cell is done, before its env is closed (for instance to film episodes).
        known: Records of cells that were evaluated before; they are not evaluated again.

    Returns:
        The records, cell after cell, ordered by episode as the split is.

    Raises:
        ConfigError: A split has fewer episodes than the protocol asks for.
        CheckpointError: The policy returned actions that cannot be executed.
    """
    records: list[EpisodeRecord] = []
    for cell in protocol.cells():
        if known and cell in known:
            records += known[cell]
            continue
        env = make_env(cell)
        try:
            of_cell = evaluate_cell(
                policy,
                env,
                protocol.episodes_of(env.split_indices),
                split=cell.split,
                level=cell.level,
                only=cell.only,
                seed=protocol.seed,
                policy_name=policy_name,
                on_episode=on_episode,
            )
            if on_cell is not None:
                on_cell(cell, env, of_cell)
        finally:
            env.close()
        records += of_cell
    return records


def evaluate_cell(
    policy: Policy,
    env: EvaluatedEnv,
    episodes: Sequence[int],
    *,
    split: str,
    level: int | None,
    seed: int,
    policy_name: str,
    only: str | None = None,
    on_episode: OnEpisode | None = None,
) -> list[EpisodeRecord]:
    """Runs the episodes of one cell.

    Args:
        policy: The policy.
        env: The env, made for this level and split.
        episodes: Indices in the task's pool of episodes, each once.
        split: Name of the split that they are of.
        level: The env's level, or None when one channel varies alone.
        seed: The protocol's seed; the policy's noise follows from it and the episode.
        policy_name: Name of the policy in the records.
        only: The channel that varies alone, or None.
        on_episode: Called with every record as soon as its episode is over, in order of finishing.

    Returns:
        One record per episode, in the order of ``episodes``.

    Raises:
        CheckpointError: The policy returned actions of another shape, or not finite.
        SimulatorError: An episode did not end after the task's number of steps.
    """
    cell = Cell(level=level, only=only, split=split)
    shared = {
        "task": env.task.name,
        "policy": policy_name,
        "level": level,
        "only": only,
        "channels": tuple(env.channels),
        "split": split,
        "seed": seed,
        "simulator": env.simulator,
        "renderer": env.renderer,
        "not_shown": tuple(env.not_shown),
        "versions": package_versions(),
    }
    done: dict[int, EpisodeRecord] = {}

    def finish(slot: _Slot, success: bool) -> None:
        done[slot.episode] = EpisodeRecord(
            **shared,
            episode=slot.episode,
            initial_state_hash=slot.state_hash,
            success=success,
            length=slot.length,
            episode_return=slot.episode_return,
            wall_time_s=slot.wall_time_s,
        )
        if on_episode is not None:
            on_episode(done[slot.episode])

    Rollout(policy, env, seed, str(cell)).run(episodes, finish)
    return [done[int(episode)] for episode in episodes]


class Rollout:
    """Runs episodes on a batched env, each in whichever env is free.

    Args:
        policy: The policy.
        env: The env.
        seed: The protocol's seed.
        where: The cell, for messages.
        on_step: Called with the env's index and the episode's length after every step, and after a
            reset with length 0.
    """

    def __init__(
        self,
        policy: Policy,
        env: EvaluatedEnv,
        seed: int,
        where: str,
        on_step: Callable[[int, int], None] | None = None,
    ) -> None:
        self._policy, self._env, self._seed, self._where = policy, env, seed, where
        self._on_step = on_step
        self._slots: dict[int, _Slot] = {}

    def run(self, episodes: Sequence[int], finish: Callable[[_Slot, bool], None]) -> None:
        """Runs every episode once.

        Args:
            episodes: Indices in the task's pool of episodes.
            finish: Called with the slot of an episode that is over, and whether it succeeded.
        """
        waiting = deque(int(episode) for episode in episodes)
        if len(set(waiting)) != len(waiting):
            raise ConfigError(f"An episode is asked for twice in {self._where}.")
        free = list(range(min(self._env.num_envs, len(waiting))))
        while waiting or self._slots:
            started = time.perf_counter()
            if waiting and free:
                self._start([(env_id, waiting.popleft()) for env_id in free[: len(waiting)]])
            # An env that needs a chunk waits for the others to use theirs up, so that one batch of
            # pictures and one inference serve all of them. Waiting costs a few steps of physics.
            ready = [env_id for env_id in sorted(self._slots) if self._slots[env_id].actions]
            if not ready:
                self._plan()
                ready = sorted(self._slots)
            else:
                self._watch(ready)
            over = self._step(ready)
            share = (time.perf_counter() - started) / len(self._slots)
            for slot in self._slots.values():
                slot.wall_time_s += share
            free = list(over)
            for env_id, success in over.items():
                finish(self._slots.pop(env_id), success)

    def _start(self, assignments: Sequence[tuple[int, int]]) -> None:
        env_ids, episodes = (np.array(column, dtype=np.int64) for column in zip(*assignments, strict=True))
        self._env.reset_envs(env_ids, episodes)
        for env_id, episode in assignments:
            self._slots[env_id] = _Slot(
                episode=episode,
                state_hash=self._env.initial_state_hash(env_id),
                generator=episode_generator(self._seed, episode),
                history=deque(maxlen=self._policy.n_obs_steps),
            )
            if self._on_step is not None:
                self._on_step(env_id, 0)

    def _observe(self, env_ids: Sequence[int]) -> None:
        observation = self._env.observe(np.array(env_ids, dtype=np.int64))
        for row, env_id in enumerate(env_ids):
            self._slots[env_id].history.append({key: value[row] for key, value in observation.items()})

    def _watch(self, env_ids: Sequence[int]) -> None:
        """Observes the envs whose present step is in the history of their next chunk."""
        needed = [
            env_id for env_id in env_ids if len(self._slots[env_id].actions) <= self._policy.n_obs_steps - 1
        ]
        if needed:
            self._observe(needed)

    def _plan(self) -> None:
        """Observes every env and asks the policy for its next chunk of actions."""
        env_ids = sorted(self._slots)
        self._observe(env_ids)
        batch = _stack([self._slots[env_id].history for env_id in env_ids], self._policy.n_obs_steps)
        chunks = self._policy.act(batch, [self._slots[env_id].generator for env_id in env_ids])
        chunks = np.asarray(chunks)
        expected = (len(env_ids), self._policy.n_action_steps, *self._env.single_action_space.shape)
        if chunks.shape != expected:
            raise CheckpointError(
                f"The policy returned actions of shape {chunks.shape}; {self._env.task.name} takes "
                f"{expected} (envs, steps, joints). Evaluate the checkpoint on the task it was trained on."
            )
        for env_id, chunk in zip(env_ids, chunks, strict=True):
            slot = self._slots[env_id]
            if not np.isfinite(chunk).all():
                raise CheckpointError(
                    f"The policy returned an action that is not finite, in episode {slot.episode} at step "
                    f"{slot.length} ({self._env.task.name}, {self._where}). Its training diverged: lower the "
                    "learning rate, or evaluate an earlier checkpoint."
                )
            slot.actions.extend(chunk)

    def _step(self, env_ids: Sequence[int]) -> dict[int, bool]:
        """Steps envs by one action each; returns those whose episode is over, and whether it succeeded."""
        actions = np.stack([self._slots[env_id].actions.popleft() for env_id in env_ids])
        outcome = self._env.step_envs(np.array(env_ids, dtype=np.int64), actions)
        over = {}
        for row, env_id in enumerate(env_ids):
            slot = self._slots[env_id]
            slot.length += 1
            slot.episode_return += float(outcome.reward[row])
            if self._on_step is not None:
                self._on_step(env_id, slot.length)
            if outcome.terminated[row] or outcome.truncated[row]:
                over[env_id] = bool(outcome.success[row])
            elif slot.length >= self._env.task.max_episode_steps:
                raise SimulatorError(
                    f"Episode {slot.episode} of {self._env.task.name} ({self._where}) did not end after "
                    f"{slot.length} steps, which is its limit. The env must report truncation there."
                )
        return over


def episode_generator(seed: int, episode: int) -> "torch.Generator":
    """Returns the source of the policy's noise in one episode.

    It follows from the protocol's seed and the episode, as everything else of the episode does, so a
    sampling policy draws the same noise whatever runs beside it.
    """
    import torch

    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(crc32(b"policy"), episode))
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]))


def _stack(histories: Sequence[deque[Observation]], n_obs_steps: int) -> dict[str, np.ndarray]:
    """Batches the newest observations; an episode's first one stands in for those before it.

    Returns:
        Arrays (n, ...), or (n, n_obs_steps, ...) for a policy with a history.
    """
    if n_obs_steps == 1:
        return {key: np.stack([history[-1][key] for history in histories]) for key in histories[0][-1]}
    padded = [[history[0]] * (n_obs_steps - len(history)) + list(history) for history in histories]
    return {
        key: np.stack([np.stack([frame[key] for frame in frames]) for frames in padded])
        for key in padded[0][0]
    }
