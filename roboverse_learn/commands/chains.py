"""``roboverse evaluate suite=calvin chains=…``: a policy in CALVIN's chains of five instructions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.text import Text

from benchmark.chain_results import FILE
from roboverse_learn.commands.checkpoint_names import checkpoint_name
from roboverse_learn.commands.report import board_paths, listed_paths
from roboverse_learn.commands.tested_checkpoint import TestedCheckpoint, to_test
from roboverse_learn.commands.tested_policy import load_policy, view_of
from roboverse_learn.config.schema import EvaluateConfig
from roboverse_learn.config.serialize import from_values, to_values

if TYPE_CHECKING:
    from benchmark.calvin_chains import ChainScores
    from envs.vector_env import RoboVerseVectorEnv


def evaluate_chains(config: EvaluateConfig) -> "tuple[ChainScores, Path]":
    """Runs the chains that have no result yet; returns the scores of all, and the file of results.

    Raises:
        ConfigError: The file of results is damaged.
        PolicyError: The checkpoint is broken, or learned other tasks.
    """
    from benchmark import calvin_chains, provenance
    from benchmark.chain_results import ChainResults
    from envs.core.git import git_sha
    from roboverse_learn.commands.called_with import command_words
    from roboverse_learn.commands.foreign_checkpoint import check_fits

    seed = config.evaluate.protocol_seed
    tested = _tested(config, calvin_chains.ENV_TASK)
    if tested.checkpoint is not None:
        check_fits(tested.checkpoint, tested.env, tested.rename_map)
    command = provenance.command_line(["roboverse", "evaluate", *command_words()])
    path = Path(config.results_dir) / FILE
    run = {"command": command, "git_sha": git_sha(), "seed": seed}
    results = ChainResults(path, _label(config, tested), run)

    def make_env(count: int) -> "RoboVerseVectorEnv":
        num_envs = min(config.evaluate.num_envs, count)
        return tested.env.make(num_envs, split="test", protocol_seed=seed, **view_of(tested.checkpoint))

    indices = range(config.first_chain, config.first_chain + config.chains)
    return calvin_chains.evaluate_chains(load_policy(tested), make_env, indices, results), path


def chains_report(scores: "ChainScores", path: Path, board: Mapping[str, Path]) -> Group:
    """The lines that CALVIN's evaluation prints, and where results are."""
    return Group(Text(scores.text()), listed_paths({"chains": path} | board_paths(board)))


def _tested(config: EvaluateConfig, task: str) -> TestedCheckpoint:
    """Returns the checkpoint, or the baseline, in a task of the scene in which chains are.

    That one task says nothing of what a chain asks for: a run of other scenes is tested in this one, too.
    """
    values = to_values(config) | {"suite": "", "chains": 0, "first_chain": 0, "task": task}
    return to_test(from_values("evaluate", values))


def _label(config: EvaluateConfig, tested: TestedCheckpoint) -> str:
    """Returns under which name results are kept: it has all that decides what the policy does."""
    from envs.core.fingerprint import digest, file_hash
    from envs.spec import EnvSpec
    from policies.checkpoint import weights_path

    scene = tested.env.to_json()
    if tested.checkpoint is None:
        own = scene == EnvSpec(task=tested.env.task).to_json()
        return tested.baseline if own else f"{tested.baseline} {digest(scene)}"
    weights = file_hash(weights_path(tested.checkpoint))[:8]
    facts: dict[str, Any] = {"env": scene, "device": tested.device, "rename_map": dict(tested.rename_map)}
    return f"{checkpoint_name(config.checkpoint, tested.checkpoint)} {weights} {digest(facts)}"
