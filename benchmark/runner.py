"""Evaluates a policy: (policy, env, protocol) to one record per episode."""

import itertools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, override
from zlib import crc32

import numpy as np

from benchmark.instruction_tests import Prompter, Scripts
from benchmark.protocol import Cell
from benchmark.protocol import Protocol as EvaluationProtocol
from benchmark.provenance import package_versions
from benchmark.records import EpisodeRecord
from benchmark.statistics import narrow_after
from envs.core.errors import CheckpointError, ConfigError
from envs.rollout import Actor, Episode, EpisodeEnv, rollout
from policies import create_scripted
from policies.base import Policy

if TYPE_CHECKING:
    import torch

    from envs.state import State

OnEpisode = Callable[[EpisodeRecord], None]


class EvaluatedEnv(EpisodeEnv, Protocol):
    """A batched environment that can be evaluated."""

    simulator: str
    renderer: str
    channels: tuple[str, ...]
    not_shown: tuple[str, ...]
    split_indices: np.ndarray

    def image(self, env_id: int, /) -> np.ndarray:
        """Returns the first camera's image of one environment, (H, W, 3) uint8, whatever is observed."""
        ...

    def set_instruction(self, env_id: int, instruction: str, /) -> None:
        """Gives an environment's episode another instruction; called by instruction tests alone."""
        ...

    def close(self) -> None:
        """Frees the simulator."""
        ...


class PolicyActor(Actor):
    """Actor that runs a policy, with a noise generator for each episode.

    Args:
        policy: The policy.
        env: The environment.
        seed: The protocol's seed.
        where: The cell, for messages.
    """

    def __init__(self, policy: Policy, env: EpisodeEnv, seed: int, where: str = "") -> None:
        self._policy, self._env, self._seed = policy, env, seed
        self._where = ", ".join(filter(None, (env.task.name, where)))
        self.n_obs_steps = policy.n_obs_steps

    @override
    def begin(self, episodes: Sequence[Episode]) -> None:
        for episode in episodes:
            episode.memory = episode_generator(self._seed, episode.episode)

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], "State"]) -> list[np.ndarray]:
        del states
        batch = _batched([episode.observations for episode in episodes], self.n_obs_steps)
        chunks = np.asarray(self._policy.act(batch, [episode.memory for episode in episodes]))
        expected = (len(episodes), self._policy.n_action_steps, *self._env.single_action_space.shape)
        if chunks.shape != expected:
            raise CheckpointError(
                f"The policy returned actions of shape {chunks.shape}; {self._env.task.name} takes "
                f"{expected} (envs, steps, joints). Evaluate the checkpoint on the task it was trained on."
            )
        for episode, chunk in zip(episodes, chunks, strict=True):
            if not np.isfinite(chunk).all():
                raise CheckpointError(
                    f"The policy returned an action that is not finite, in episode {episode.episode} at step "
                    f"{episode.length} ({self._where}). Its training diverged: lower the learning rate, or "
                    "evaluate an earlier checkpoint."
                )
        return list(chunks)


@dataclass(frozen=True, slots=True)
class Baseline:
    """Policy without training: a rule, such as random actions, or the task's expert.

    It is made for each environment, whose actions or task it needs.

    Attributes:
        name: ``"expert"``, or one of ``policies.names("nothing")``.
    """

    name: str

    def actor(self, env: Any, seed: int, where: str) -> Actor:
        """Returns what acts in an environment; see :class:`PolicyActor`."""
        if self.name != EXPERT:
            policy = create_scripted(self.name, env.single_action_space)
            policy.task = env.task.name
            return PolicyActor(policy, env, seed, where)
        from envs.experts.actor import ExpertActor

        actor = ExpertActor(env)
        actor.tail_steps = None  # the environment decides when the episode is over, as for any policy
        return actor


EXPERT = "expert"
"""Name of the baseline that is the task's scripted expert."""


def actor_of(policy: Policy | Baseline, env: EvaluatedEnv, seed: int, where: str) -> Actor:
    """Returns the actor of a policy or a baseline; see :class:`PolicyActor`."""
    if isinstance(policy, Baseline):
        return policy.actor(env, seed, where)
    return PolicyActor(policy, env, seed, where)


def evaluate(
    policy: Policy | Baseline,
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
        ConfigError: A split has fewer episodes than the protocol.
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
                width=protocol.width,
                instruction_test=cell.instruction_test,
                right=[record for record in records if record.cell == cell.right],
            )
            if on_cell is not None:
                on_cell(cell, env, of_cell)
        finally:
            env.close()
        records += of_cell
    return records


def evaluate_cell(
    policy: Policy | Baseline,
    env: EvaluatedEnv,
    episodes: Sequence[int],
    *,
    split: str,
    level: int | None,
    seed: int,
    policy_name: str,
    only: str | None = None,
    on_episode: OnEpisode | None = None,
    width: float | None = None,
    instruction_test: str | None = None,
    right: Sequence[EpisodeRecord] = (),
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
        width: Ends the cell at the first episode, in the order of ``episodes``, after which the interval is
            this narrow; see :class:`~benchmark.protocol.Protocol`. Later episodes that ran beside it do not
            count, so the records do not depend on the number of environments.
        instruction_test: What the instruction is instead of the task's own, or None; see
            :data:`~benchmark.protocol.INSTRUCTION_TESTS`.
        right: For a test: the records of the same episodes with the right instruction.

    Returns:
        One record per episode, in the order of ``episodes``.

    Raises:
        CheckpointError: The policy returned actions of another shape, or not finite.
        SimulatorError: An episode did not end after the task's number of steps.
    """
    cell = Cell(level=level, only=only, split=split, instruction_test=instruction_test)
    prompter = None
    if instruction_test is not None:
        lengths = {record.episode: record.length for record in right}
        prompter = Prompter(env, Scripts(instruction_test, env.task, seed, lengths))
    shared = _shared_facts(env, cell) | {"policy": policy_name, "seed": seed}
    if len(set(episodes)) != len(episodes):
        raise ConfigError(f"An episode is listed twice in {cell}.")
    done: dict[int, EpisodeRecord] = {}
    actor = actor_of(policy, env, seed, str(cell))
    for episode in rollout(env, actor, episodes, on_step=prompter or (lambda _: None)):
        done[episode.position] = EpisodeRecord(
            **shared,
            episode=episode.episode,
            initial_state_hash=episode.initial_state_hash,
            success=episode.success,
            length=episode.length,
            episode_return=episode.episode_return,
            wall_time_s=round(episode.wall_time_s, 6),
            instruction=episode.instruction,
            **({} if prompter is None else prompter.facts(episode)),
        )
        if on_episode is not None:
            on_episode(done[episode.position])
        if width is not None and (enough := _narrow_after(done, width)) is not None:
            return [done[position] for position in range(enough)]
    return [done[position] for position in sorted(done)]


def _shared_facts(env: EvaluatedEnv, cell: Cell) -> dict[str, Any]:
    """Returns what the records of a cell have in common."""
    return {
        "task": env.task.name,
        "level": cell.level,
        "only": cell.only,
        "channels": tuple(env.channels),
        "split": cell.split,
        "instruction_test": cell.instruction_test,
        "simulator": env.simulator,
        "renderer": env.renderer,
        "not_shown": tuple(env.not_shown),
        "versions": package_versions(),
    }


def _narrow_after(done: Mapping[int, EpisodeRecord], width: float) -> int | None:
    """Returns after how many of the episodes, in order and without a gap, the interval is narrow enough."""
    first = list(itertools.takewhile(done.__contains__, range(len(done))))
    return narrow_after([done[position].success for position in first], width)


def episode_generator(seed: int, episode: int) -> "torch.Generator":
    """Returns the source of the policy's noise in one episode, whatever runs beside it."""
    import torch

    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(crc32(b"policy"), episode))
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]))


def _batched(histories: Sequence[deque[dict[str, np.ndarray]]], n_obs_steps: int) -> dict[str, np.ndarray]:
    """Batches the newest observations; an episode's first one is repeated for those before it.

    Returns:
        Arrays (n, ...), or (n, n_obs_steps, ...) for a policy with a history.
    """
    padded = [[history[0]] * (n_obs_steps - len(history)) + list(history) for history in histories]
    if n_obs_steps == 1:
        return {key: np.stack([frames[-1][key] for frames in padded]) for key in padded[0][-1]}
    return {
        key: np.stack([np.stack([frame[key] for frame in frames]) for frames in padded])
        for key in padded[0][0]
    }
