"""Finds states in the middle of CALVIN's chains, in which demonstrations for chains begin.

``python -m benchmark.calvin_states`` lets the expert do chains that are drawn as the authors draw theirs, but
with other random numbers, and writes the state in which each of their tasks ended.
"""

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import override

from benchmark.calvin_chains import ENV_TASK, ChainEnv, ChainExpert, run_chains
from envs.core.arguments import run_program
from envs.core.ranges import check_ranges
from envs.randomization import channel_rng
from envs.rollout import Episode
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks.calvin.chain_states import ChainStates
from envs.tasks.calvin.sequences import Chain, after, chains_from, start_symbols
from envs.tasks.calvin.starts import initial_state
from envs.tasks.calvin.task import CalvinTask
from envs.vector_env import RoboVerseVectorEnv

logger = logging.getLogger(__name__)

_COMMAND = "python -m benchmark.calvin_states"


@dataclass(frozen=True, kw_only=True, slots=True)
class StatesSettings:
    """Settings of the command.

    Attributes:
        chains: Chains that the expert does; each gives up to as many states as it has tasks.
        num_envs: Environments stepped at once.
        seed: Seed of the chains and of their starts.
        out: File of the states; the package's own is ``envs/tasks/calvin/chain_states.npz``.
    """

    chains: int = 600
    num_envs: int = 8
    seed: int = 0
    out: Path = Path("chain_states.npz")

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("chains", "num_envs"), from_0=("seed",))


def main(words: Sequence[str] | None = None) -> int:
    """Finds the states and writes them; returns the exit code."""
    return run_program(_COMMAND, StatesSettings, _write_states, words)


def _write_states(settings: StatesSettings) -> None:
    env = EnvSpec(task=ENV_TASK).make(settings.num_envs, observation="state")
    try:
        states = found_states(env, range(settings.chains), settings.seed)
    finally:
        env.close()
    states.save(settings.out)
    logger.info("%d states of %d chains: %s", len(states.led), settings.chains, settings.out)


def found_states(env: RoboVerseVectorEnv, indices: Sequence[int], seed: int = 0) -> ChainStates:
    """Returns the states in which tasks of chains ended, chain by chain.

    Args:
        env: Environments of scene D.
        indices: Which chains.
        seed: Seed of the chains and of their starts.
    """
    chains = _OwnChains(env, {index: drawn_chain(index, seed) for index in indices}, seed)
    found: dict[int, list[ChainStates]] = {index: [] for index in indices}
    solved = Counter[int]()

    def note(episode: Episode) -> None:
        if episode.success:
            solved[episode.episode] += 1
            symbols = chains.symbols_after(episode.episode, solved[episode.episode])
            ended = ChainStates.of(env.get_states([episode.env_id]), [symbols])
            if bool(ended.led[0]) == bool(symbols["led"]):  # else the hand pressed the button in passing
                found[episode.episode].append(ended)

    for place, _ in enumerate(run_chains(chains, ChainExpert(chains), indices, note), 1):
        logger.info("%d of %d chains", place, len(indices))
    return ChainStates.joined([part for index in indices for part in found[index]])


def drawn_chain(index: int, seed: int) -> Chain:
    """Returns a chain by the authors' rule, from random numbers of its own."""
    rng, starts = channel_rng(seed, "calvin chain", index), start_symbols()
    start = starts[int(rng.integers(len(starts)))]
    (tasks,) = chains_from(start, 1, int(rng.integers(2**31)))
    return start, tasks


class _OwnChains(ChainEnv):
    """Chains whose starts are drawn: blocks turned, and the arm moved a little.

    Args:
        env: The environments.
        chains: The chain of each index.
        seed: Seed of the starts.
    """

    def __init__(self, env: RoboVerseVectorEnv, chains: dict[int, Chain], seed: int) -> None:
        super().__init__(env, chains)
        assert isinstance(env.task, CalvinTask), "chains are of CALVIN's tasks"
        self._own, self._drawn, self._seed = env.task, chains, seed

    @override
    def initial_states(self, indices: Sequence[int]) -> State:
        rngs = [channel_rng(self._seed, "calvin chain start", index) for index in indices]
        symbols = [self._drawn[index][0] for index in indices]
        return initial_state("D", self._own.scenario, symbols, rngs, self._own.drawn_qpos(rngs))

    def symbols_after(self, index: int, count: int) -> dict[str, int | str]:
        """Returns the symbolic state of a chain after some of its tasks."""
        symbols, tasks = self._drawn[index]
        for task in tasks[:count]:
            (symbols,) = after(symbols, task)
        return symbols


if __name__ == "__main__":
    raise SystemExit(main())
