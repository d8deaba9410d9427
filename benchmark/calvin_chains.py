"""CALVIN's long-horizon evaluation: chains of five instructions in scene D, one state after another.

``python -m benchmark.calvin_chains policy=expert chains=1000`` runs the authors' chains, 360 steps an
instruction at most, prints what their evaluation prints, and keeps each chain's result in a file; run again,
it resumes. ``checkpoint=<folder>`` evaluates a trained policy.
"""

import logging
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, override

import numpy as np

from benchmark.chain_results import ChainResults
from benchmark.provenance import portable
from benchmark.runner import PolicyActor
from envs.batched_env import StepResult
from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from envs.core.fingerprint import digest, file_hash
from envs.core.git import git_sha
from envs.randomization import channel_rng
from envs.rollout import Actor, Episode, rollout
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import Entry, task_facts
from envs.tasks.calvin.rules import met
from envs.tasks.calvin.sequences import CHAIN_LENGTH, NUM_CHAINS, STEPS_PER_TASK, Chain, all_chains
from envs.tasks.calvin.starts import protocol_state
from envs.tasks.waypoint_planner import WaypointPlanner
from envs.vector_env import RoboVerseVectorEnv

logger = logging.getLogger(__name__)

_COMMAND = "python -m benchmark.calvin_chains"

ENV_TASK = Entry("D", "open_drawer").name
"""Any task of the scene: what counts is checked here."""

PROTOCOL_SEED = 0
"""Seeds the expert's, or the policy's, random numbers."""


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
        states = protocol_state(self._env.scenario, [symbols for symbols, _ in chains])
        self._env.reset_envs(env_ids, np.repeat(self._env.split_indices[:1], len(env_ids)), states)
        for env_id, (_, tasks) in zip(env_ids.tolist(), chains, strict=True):
            self._running[env_id] = _Running(tasks)
            self._instruct(env_id)

    def step_envs(self, env_ids: np.ndarray, actions: np.ndarray) -> StepResult:
        """Steps these environments; ``success`` says where the step solved a task of the chain."""
        self._env.step_envs(env_ids, actions)
        states = self._env.get_states(env_ids)
        chains = [self._running[env_id] for env_id in env_ids.tolist()]
        success = np.array(
            [
                bool(met(task_facts()[self.task_of(env_id)].rule, states.select([row]))[0])
                for row, env_id in enumerate(env_ids.tolist())
            ]
        )
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

    def _instruct(self, env_id: int) -> None:
        self._env.set_instruction(env_id, task_facts()[self.task_of(env_id)].instruction)

    def _remember(self, ids: np.ndarray, states: State, solved: list[int]) -> None:
        """Makes present states starts where a task was solved, and notes lights where they changed."""
        poses = memory.begun_here(states, solved)
        changed = [
            row
            for row in range(len(ids))
            if row in solved
            or any(
                bool((pos[row] != states.objects[name].pos[row]).any()) for name, (pos, _) in poses.items()
            )
        ]
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
        self._planners: dict[str, WaypointPlanner] = {}

    @override
    def begin(self, episodes: Sequence[Episode]) -> None:
        for episode in episodes:
            episode.memory = channel_rng(self._env.protocol_seed, "expert", episode.episode)

    @override
    def act(self, episodes: Sequence[Episode], states: Callable[[], State]) -> list[np.ndarray]:
        present = states()
        return [
            self._planner(self._env.task_of(episode.env_id)).plan(present.select([row]), episode.memory)
            for row, episode in enumerate(episodes)
        ]

    def _planner(self, task: str) -> WaypointPlanner:
        if task not in self._planners:
            from envs.tasks.calvin.expert import plan

            robot = self._env.task.robot

            def expert(state: State, rng: np.random.Generator):
                return plan("D", task, robot, state, rng)

            self._planners[task] = WaypointPlanner(self._env.scenario, expert)
        return self._planners[task]


def run_chains(env: ChainEnv, actor: Actor, indices: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yields the index of each chain as it ends, and how many of its tasks were solved in a row.

    Args:
        env: The environments.
        actor: Chooses actions: a :class:`ChainExpert`, or a policy's.
        indices: Which chains.
    """

    def start_afresh(episode: Episode) -> None:
        """Drops what was planned and seen for an instruction that is solved."""
        if episode.success:
            episode.plan.clear()
            episode.observations.clear()

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


@dataclass(frozen=True, kw_only=True, slots=True)
class ChainSettings:
    """Settings of the command.

    Attributes:
        policy: ``expert``; empty takes ``checkpoint``.
        checkpoint: Folder of a trained policy.
        chains: How many of the protocol's 1,000 chains.
        first: Index of the first of them.
        num_envs: Environments stepped at once.
        looks: What is rendered for a policy; see :class:`~envs.tasks.calvin.task.CalvinTask`.
        action_space: ``joints`` or ``native``, as the policy was trained; the expert's are joints.
        observation_space: Likewise.
        cameras: Cameras of a policy; none takes those that the checkpoint saw.
        image_size: Pixels along the shorter side of their images; 0 takes what the checkpoint saw.
        device: Device of a policy.
        results: File of results.
    """

    policy: str = "expert"
    checkpoint: str = ""
    chains: int = NUM_CHAINS
    first: int = 0
    num_envs: int = 4
    looks: str = "boxes"
    action_space: str = "joints"
    observation_space: str = "joints"
    cameras: tuple[str, ...] = ()
    image_size: int = 0
    device: str = "cpu"
    results: Path = Path("results/calvin_chains.json")


def main(words: Sequence[str] | None = None) -> int:
    """Runs the chains that have no result yet; returns the exit code."""
    given = sys.argv[1:] if words is None else words

    def run(settings: ChainSettings) -> None:
        _check(settings)
        logger.info("%s", evaluate(settings, given).text())

    return run_program(_COMMAND, ChainSettings, run, given)


def _check(settings: ChainSettings) -> None:
    if not 1 <= settings.chains <= NUM_CHAINS - settings.first <= NUM_CHAINS:
        raise ConfigError(
            f"first and chains name some of the {NUM_CHAINS} chains, counted from 0: chains is from 1 to "
            f"{NUM_CHAINS}, given {settings.chains}, first={settings.first}."
        )
    if not settings.checkpoint and settings.action_space != "joints":
        raise ConfigError("The expert of chains acts in joints. Leave out action_space=native.")
    if settings.policy != "expert" and not settings.checkpoint:
        raise ConfigError(f"policy is expert, or give checkpoint=<folder>; given {settings.policy}.")


def evaluate(settings: ChainSettings, command: Sequence[str] = ()) -> ChainScores:
    """Runs the chains that have no result yet, keeps their results, and returns all scores.

    Args:
        settings: Which.
        command: Words of the command, kept beside the results.

    Raises:
        ConfigError: The file of results is damaged.
    """
    words = shlex.join(str(portable(word)) for word in command)
    run = {"command": f"{_COMMAND} {words}".strip(), "git_sha": git_sha(), "seed": PROTOCOL_SEED}
    results = ChainResults(settings.results, _label(settings), run)
    indices = range(settings.first, settings.first + settings.chains)
    missing = [index for index in indices if index not in results.done]
    if missing:
        env = _env(settings, min(settings.num_envs, len(missing)))
        try:
            chains_env = ChainEnv(env, {index: all_chains()[index] for index in missing})
            chains = run_chains(chains_env, _actor(settings, chains_env), missing)
            for place, (index, count) in enumerate(chains, 1):
                results.add(index, count)
                logger.info("%d: %d of %d (%d of %d chains)", index, count, CHAIN_LENGTH, place, len(missing))
        finally:
            env.close()
    return ChainScores(
        tuple(results.done[index] for index in indices), tuple(all_chains()[index][1] for index in indices)
    )


def _label(settings: ChainSettings) -> str:
    """Returns under which name results are kept: of a checkpoint, all that decides what it does."""
    if not settings.checkpoint:
        return settings.policy
    from policies.checkpoint import resolve, weights_path

    weights = file_hash(weights_path(resolve(settings.checkpoint)))[:8]
    seen = ("looks", "action_space", "observation_space", "cameras", "image_size", "device")
    facts = {key: getattr(settings, key) for key in seen}
    return f"{portable(settings.checkpoint)} {weights} {digest(facts)}"


def _env(settings: ChainSettings, num_envs: int) -> RoboVerseVectorEnv:
    kwargs = {key: getattr(settings, key) for key in ("looks", "action_space", "observation_space")}
    spec = EnvSpec(task=ENV_TASK, task_kwargs=kwargs, **_images(settings))
    observation = "pixels" if settings.checkpoint else "state"
    return spec.make(
        num_envs, split="test", observation=observation, num_threads=1, protocol_seed=PROTOCOL_SEED
    )


def _images(settings: ChainSettings) -> dict[str, Any]:
    """Returns the cameras and the image size: as given, else as the checkpoint saw them."""
    from policies.checkpoint import resolve, seen_cameras

    seen = seen_cameras(resolve(settings.checkpoint)) if settings.checkpoint else {}
    images: dict[str, Any] = {"cameras": settings.cameras or tuple(seen)}
    sizes = {settings.image_size} if settings.image_size else set(seen.values())
    return images | ({"image_size": sizes.pop()} if len(sizes) == 1 else {})


def _actor(settings: ChainSettings, env: Any) -> Actor:
    if not settings.checkpoint:
        return ChainExpert(env)
    from policies import load

    policy = load(settings.checkpoint, settings.device)
    policy.task = ENV_TASK
    return PolicyActor(policy, env, env.protocol_seed, "chains")


if __name__ == "__main__":
    sys.exit(main())
