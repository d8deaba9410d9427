"""CALVIN's long-horizon evaluation: chains of five instructions in scene D, one state after another.

``roboverse evaluate suite=calvin chains=1000`` runs the authors' chains, at most 360 steps each, and
prints what their evaluation prints.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, override

import numpy as np
import torch

from benchmark.chain_results import ChainResults
from benchmark.runner import EXPERT, Baseline, actor_of
from envs.batched_env import StepResult
from envs.randomization import channel_rng
from envs.rollout import Actor, Episode, OnStep, rollout
from envs.state import State
from envs.tasks import TASKS
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import Entry, task_facts
from envs.tasks.calvin.rules import met
from envs.tasks.calvin.scene import TABLE
from envs.tasks.calvin.sequences import CHAIN_LENGTH, STEPS_PER_TASK, Chain, all_chains
from envs.tasks.calvin.starts import protocol_state
from envs.tasks.planner import Planner
from envs.vector_env import RoboVerseVectorEnv
from policies.base import Policy

logger = logging.getLogger(__name__)

ENV_TASK = Entry("D", "open_drawer").name
"""Any task of the scene: what counts is checked here."""


@dataclass(slots=True)
class _Running:
    """A chain in an environment.

    Attributes:
        tasks: Its tasks.
        done: How many of them are solved.
        steps: Control steps of the present task.
    """

    tasks: tuple[str, ...]
    done: int = 0
    steps: int = 0


class ChainEnv:
    """Environments of scene D whose episodes are chains: an instruction starts where the last one ended.

    Args:
        env: The environments.
        chains: The chain of each index.
    """

    max_episode_steps = CHAIN_LENGTH * STEPS_PER_TASK

    def __init__(self, env: RoboVerseVectorEnv, chains: Mapping[int, Chain]) -> None:
        self._env, self._chains = env, chains
        self._running: dict[int, _Running] = {}  # by environment

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def task_of(self, env_id: int) -> str:
        """Returns the task that the chain of an environment is at."""
        chain = self._running[env_id]
        return chain.tasks[chain.done]

    def reset_envs(self, env_ids: np.ndarray, episodes: np.ndarray) -> None:
        """Starts the chains of these indices in these environments."""
        chains = [self._chains[index] for index in episodes.tolist()]
        states = self.initial_states(episodes.tolist())
        self._env.reset_envs(env_ids, np.repeat(self._env.split_indices[:1], len(env_ids)), states)
        for env_id, (_, tasks) in zip(env_ids.tolist(), chains, strict=True):
            self._running[env_id] = _Running(tasks)
            self._instruct(env_id)

    def initial_states(self, indices: Sequence[int]) -> State:
        """Returns the states in which chains begin, one row each."""
        return protocol_state(self._env.scenario, [self._chains[index][0] for index in indices])

    def step_envs(self, env_ids: np.ndarray, actions: np.ndarray) -> StepResult:
        """Steps these environments; ``success`` says where the step solved a task of the chain."""
        self._env.step_envs(env_ids, actions)
        present = self._env.get_states(env_ids)
        states = present.to("cpu", present.objects[TABLE].pos.dtype)  # as it is: markers are compared exactly
        chains = [self._running[env_id] for env_id in env_ids.tolist()]
        success = self._solved(env_ids, states)
        self._remember(env_ids, states, np.flatnonzero(success).tolist())
        for chain, env_id, solved in zip(chains, env_ids.tolist(), success, strict=True):
            chain.steps += 1
            if solved:
                chain.done, chain.steps = chain.done + 1, 0
                if chain.done < len(chain.tasks):
                    self._instruct(env_id)
        complete = np.array([chain.done == len(chain.tasks) for chain in chains])
        late = np.array([chain.steps >= STEPS_PER_TASK for chain in chains])
        return StepResult(success.astype(np.float32), complete, late, success)

    def _solved(self, env_ids: np.ndarray, states: State) -> np.ndarray:
        """Returns where the present task of a chain is solved, (n,) bool; each rule is asked once."""
        rows: dict[str, list[int]] = {}
        for row, env_id in enumerate(env_ids.tolist()):
            rows.setdefault(self.task_of(env_id), []).append(row)
        solved = np.zeros(len(env_ids), bool)
        for task, at_it in rows.items():
            solved[at_it] = met(task_facts()[task].rule, states.select(at_it)).numpy()
        return solved

    def _instruct(self, env_id: int) -> None:
        self._env.set_instruction(env_id, task_facts()[self.task_of(env_id)].instruction)

    def _remember(self, ids: np.ndarray, states: State, solved: list[int]) -> None:
        """Makes present states starts where a task was solved, and notes lights where they changed."""
        poses = memory.begun_here(states, solved)
        differs = torch.zeros(len(ids), dtype=torch.bool)
        differs[solved] = True
        for name, (pos, _) in poses.items():
            differs |= (pos != states.objects[name].pos).any(-1)
        changed = differs.nonzero().flatten().tolist()
        if changed:
            moved = {name: (pos[changed], rot[changed]) for name, (pos, rot) in poses.items()}
            self._env.handler.set_poses(moved, ids[changed])


class ChainExpert(Actor):
    """The expert of whichever task a chain is at.

    Args:
        env: The environment.
    """

    def __init__(self, env: ChainEnv) -> None:
        self._env = env
        self._planners: dict[str, Planner] = {}

    @override
    def begin(self, episodes: Sequence[Episode]) -> None:
        for episode in episodes:
            episode.memory = channel_rng(self._env.protocol_seed, "expert", episode.episode)

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        present = states()
        plans = [
            self._planner(self._env.task_of(episode.env_id)).plan(present.select([row]), episode.memory)
            for row, episode in enumerate(episodes)
        ]
        return [self._env.controller.of_joint_targets(plan) for plan in plans]

    def _planner(self, task: str) -> Planner:
        if task not in self._planners:
            own = self._env.task
            options = {item.name: getattr(own, item.name) for item in fields(own) if item.init}
            self._planners[task] = TASKS.get(Entry("D", task).name)(**options).planner
        return self._planners[task]


def run_chains(
    env: ChainEnv, actor: Actor, indices: Iterable[int], on_step: OnStep = lambda episode: None
) -> Iterator[tuple[int, int]]:
    """Yields the index of each chain as it ends, and how many of its tasks were solved in a row.

    Args:
        env: The environments.
        actor: Chooses actions; see :func:`chain_actor`.
        indices: Which chains.
        on_step: As that of :func:`~envs.rollout.rollout`; the instruction is then already the next one.
    """

    def start_afresh(episode: Episode) -> None:
        """Drops what was planned and seen for an instruction that is solved."""
        if episode.success:
            episode.plan.clear()
            episode.observations.clear()
        on_step(episode)

    for episode in rollout(env, actor, indices, on_step=start_afresh):
        yield episode.episode, int(episode.successes.sum())


@dataclass(frozen=True, slots=True)
class ChainScores:
    """Scores of chains, as CALVIN's evaluation prints them.

    Attributes:
        completed: How many tasks of each chain were solved in a row.
        chains: The tasks of each.
    """

    completed: tuple[int, ...]
    chains: tuple[tuple[str, ...], ...]

    @property
    def average_length(self) -> float:
        """Mean number of tasks solved in a row, 0 to 5."""
        return float(np.mean(self.completed))

    @property
    def rates(self) -> tuple[float, ...]:
        """Shares of chains in which at least 1, 2, … tasks were solved in a row."""
        counts = np.array(self.completed)
        return tuple(float((counts >= least).mean()) for least in range(1, CHAIN_LENGTH + 1))

    @property
    def by_task(self) -> dict[str, tuple[int, int]]:
        """Task to how often it was solved, and how often a chain reached it."""
        solved, tried = Counter[str](), Counter[str]()
        for done, tasks in zip(self.completed, self.chains, strict=True):
            solved.update(tasks[:done])
            tried.update(tasks[: done + 1])
        return {task: (solved[task], tried[task]) for task in task_facts() if tried[task]}

    def text(self) -> str:
        """Returns the lines that are printed."""
        lines = [
            f"Average successful sequence length: {self.average_length:.3f} ({len(self.completed)} chains)",
            "Success rates for i instructions in a row:",
            *(f"{count}: {100 * rate:.1f}%" for count, rate in enumerate(self.rates, 1)),
            *(f"{task}: {a} / {b} |  SR: {100 * a / b:.1f}%" for task, (a, b) in self.by_task.items()),
        ]
        return "\n".join(lines)


def chain_actor(policy: Policy | Baseline, env: ChainEnv) -> Actor:
    """Returns the actor of a policy or a baseline in chains."""
    if isinstance(policy, Baseline) and policy.name == EXPERT:
        return ChainExpert(env)
    evaluated: Any = env  # passes on what it lacks
    return actor_of(policy, evaluated, env.protocol_seed, "chains")


def evaluate_chains(
    policy: Policy | Baseline,
    make_env: Callable[[int], RoboVerseVectorEnv],
    indices: Sequence[int],
    results: ChainResults,
) -> ChainScores:
    """Runs the chains that have no result yet, keeps their results, and returns the scores of all.

    Args:
        policy: The policy, or a baseline.
        make_env: Makes environments of :data:`ENV_TASK` for a number of chains that are to be run.
        indices: Which chains.
        results: The results of this policy.
    """
    missing = [index for index in indices if index not in results.done]
    if missing:
        env = make_env(len(missing))
        try:
            chains_env = ChainEnv(env, {index: all_chains()[index] for index in missing})
            chains = run_chains(chains_env, chain_actor(policy, chains_env), missing)
            for place, (index, count) in enumerate(chains, 1):
                results.add(index, count)
                logger.info("%d: %d of %d (%d of %d chains)", index, count, CHAIN_LENGTH, place, len(missing))
        finally:
            env.close()
    return ChainScores(
        tuple(results.done[index] for index in indices), tuple(all_chains()[index][1] for index in indices)
    )
