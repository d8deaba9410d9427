"""``python roboverse_learn/evaluate.py checkpoint=…``: a policy, or a baseline, over levels and splits."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import dataclasses
import itertools
import logging
import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from benchmark.protocol import Cell, Protocol
from envs.core.errors import ConfigError
from roboverse_learn.commands.called_with import command_words
from roboverse_learn.commands.outcomes import Evaluation
from roboverse_learn.commands.scene_labels import recorded_materials
from roboverse_learn.commands.tested_checkpoint import (
    TestedCheckpoint,
    checkpoints_to_test,
    protocol_of,
)
from roboverse_learn.commands.tested_policy import load_policy, view_of
from roboverse_learn.config.preflight import check_materials, check_scenario_files
from roboverse_learn.config.schema import EvaluateConfig, EvaluationConfig

if TYPE_CHECKING:
    from benchmark.finished_cells import FinishedCells
    from benchmark.records import Checkpoint, EpisodeRecord, Result
    from policies.base import Policy
    from policies.function import FunctionPolicy
    from roboverse_learn.commands.suite import SuiteEvaluation

log = logging.getLogger(__name__)


def evaluate(config: EvaluateConfig) -> Any:
    """Evaluates a checkpoint or a baseline, writes its results and the leaderboard; returns a report.

    See :func:`evaluate_all`.
    """
    from roboverse_learn.commands.report import evaluation_report
    from roboverse_learn.commands.tasks_at_once import keeps_cells_alone
    from roboverse_learn.leaderboard import report_with_leaderboard

    results_dir = Path(config.results_dir)
    if keeps_cells_alone():
        return f"The cells of {len(evaluate_all(config))} tasks are evaluated."
    if config.chains:
        from roboverse_learn.commands.chains import chains_report, evaluate_chains

        scores, path = evaluate_chains(config)
        return report_with_leaderboard(results_dir, (), lambda board: chains_report(scores, path, board))
    if config.suite:
        from roboverse_learn.commands.suite_report import suite_evaluation_report

        suite = _of_suite(config)
        return report_with_leaderboard(
            results_dir, suite.evaluations.values(), lambda board: suite_evaluation_report(suite, board)
        )
    evaluations = evaluate_all(config)
    return report_with_leaderboard(
        results_dir, evaluations, lambda board: evaluation_report(evaluations, board)
    )


def evaluate_all(config: EvaluateConfig) -> list[Evaluation]:
    """Evaluates a checkpoint or a baseline and writes its results, one file per task.

    What learned several tasks is evaluated in each of them, or in those that are named, or in each of the
    suite that is named.

    Raises:
        ConfigError: The task or the image size is needed and was not given; or chains are, which have scores
            of their own.
        PolicyError: The checkpoint is broken, or learned other tasks.
    """
    from roboverse_learn.commands.tasks_at_once import evaluate_in_parallel

    check_materials(config.evaluate.materials)
    if config.chains:
        raise ConfigError(
            "evaluate() returns evaluations of tasks. For scores of chains run roboverse evaluate "
            "suite=calvin chains=<how many>, or call roboverse_learn.commands.chains.evaluate_chains."
        )
    if config.suite:
        return list(_of_suite(config).evaluations.values())
    results, tested = Path(config.results_dir), checkpoints_to_test(config)
    evaluate_in_parallel(config, [each.env.task for each in tested])
    return [evaluate_checkpoint(each, config.evaluate, results, "evaluate") for each in tested]


def _of_suite(config: EvaluateConfig) -> "SuiteEvaluation":
    """Evaluates every task of a suite, and writes its results."""
    from roboverse_learn.commands.suite import evaluate_suite

    check_materials(config.evaluate.materials)
    results = Path(config.results_dir)
    return evaluate_suite(
        config, lambda tested: evaluate_checkpoint(tested, config.evaluate, results, "evaluate")
    )


def evaluate_checkpoint(
    tested: TestedCheckpoint, config: EvaluationConfig, results_dir: Path, command: str
) -> Evaluation:
    """Evaluates a checkpoint on every cell, films it, and writes its results file.

    An evaluation of the same checkpoint under the same protocol is not run a second time.

    Args:
        tested: The checkpoint and its environment, whose task it learned.
        config: What to evaluate it on.
        results_dir: Folder of results.
        command: The command of ours that runs, as it is recorded.
    """
    from benchmark.finished_cells import FinishedCells
    from benchmark.instruction_tests import check_instruction_tests
    from benchmark.results import result_path, video_dir, write_result
    from policies.checkpoint import policy_label
    from roboverse_learn.commands.foreign_checkpoint import check_fits
    from roboverse_learn.commands.tasks_at_once import keeps_cells_alone

    protocol = protocol_of(config)
    name = tested.baseline if tested.checkpoint is None else policy_label(tested.checkpoint)
    checkpoint = _recorded(tested.checkpoint)
    path = results_dir / protocol.version / tested.env.task / name / f"{tested.run}.json"
    materials = recorded_materials(config.materials)
    earlier = _earlier(path, checkpoint.hash, protocol, tested, materials)
    if earlier is not None:
        log.info("Evaluated before: %s", path)
        return Evaluation(path=path, result=earlier, videos=_videos(path), reused=True)

    looks = {"evaluate.materials": config.materials}
    check_scenario_files(tested.env, looks)
    if tested.checkpoint is not None:
        check_fits(tested.checkpoint, tested.env, tested.rename_map)
    if protocol.instructions:
        check_instruction_tests(tested.env.make_task(), protocol.instructions)
    policy = load_policy(tested)
    finished = FinishedCells(path, _deciding(tested, protocol, checkpoint.hash, materials))
    if finished.records:
        log.info("Evaluated before: %s", ", ".join(map(str, finished.records)))
    else:
        for old in _videos(path):
            old.unlink()
            old.with_suffix(".png").unlink(missing_ok=True)  # its poster
    view = view_of(tested.checkpoint)
    records, facts = _run_cells(policy, name, tested, config, view, video_dir(path), finished)
    facts["env"] = tested.env.replace(cameras=facts.pop("cameras"), materials=materials)
    result = _result(tested, name, protocol, checkpoint, command, records, facts)
    assert path == result_path(results_dir, result)
    if keeps_cells_alone():
        return Evaluation(path=path, result=result, videos=_videos(path))
    write_result(path, result)
    finished.remove()
    _write_curve(path, tested)
    return Evaluation(path=path, result=result, videos=_videos(path))


def evaluate_policy(policy: "Policy | FunctionPolicy", config: EvaluateConfig) -> list[Evaluation]:
    """Evaluates a policy that is in memory, on every cell of each named task; writes nothing.

    Args:
        policy: The policy; it sees images where ``config.env`` names cameras, and the whole state otherwise.
        config: The environment and what to evaluate on, as for a baseline.
    """
    check_materials(config.evaluate.materials)
    return [_in_memory(policy, tested, config) for tested in checkpoints_to_test(config)]


def _in_memory(
    policy: "Policy | FunctionPolicy", tested: TestedCheckpoint, config: EvaluateConfig
) -> Evaluation:
    check_scenario_files(tested.env, {"evaluate.materials": config.evaluate.materials})
    policy.task, name = tested.env.task, getattr(policy, "name", "function")
    observation = "pixels" if config.env.get("cameras") else "full"
    view = {"observation": observation, "actions": policy.actions_of}
    records, facts = _run_cells(policy, name, tested, config.evaluate, view)
    materials = recorded_materials(config.evaluate.materials)
    facts["env"] = tested.env.replace(cameras=facts.pop("cameras"), materials=materials)
    tested = dataclasses.replace(tested, run=name, baseline="", config={})
    protocol = protocol_of(config.evaluate)
    result = _result(tested, name, protocol, _recorded(None), "evaluate", records, facts)
    return Evaluation(path=None, result=result, videos=())


def _recorded(checkpoint: Path | None) -> "Checkpoint":
    """Returns a checkpoint as a result records it."""
    from benchmark.records import Checkpoint
    from envs.core.fingerprint import file_hash
    from policies.checkpoint import weights_path
    from roboverse_learn.commands.run_folder import step_of

    if checkpoint is None:
        return Checkpoint()
    return Checkpoint(step=step_of(checkpoint), hash=file_hash(weights_path(checkpoint)))


def _write_curve(path: Path, tested: TestedCheckpoint) -> None:
    """Puts the learning curve of a run beside its result in the task and scene that it learned."""
    from benchmark.learning_curves import MEASURES, write_curve
    from roboverse_learn.commands.run_folder import read_config, run_of
    from roboverse_learn.training.metrics import read_metrics

    run = None if tested.checkpoint is None else run_of(tested.checkpoint)
    learned = tested.training.tasks
    if run is None or (learned and tested.env.task not in learned):
        return
    trained = read_config(run)
    scene = ("task_kwargs", "robot", "simulator", "simulator_settings", "scenario", "renderer")
    if all(getattr(tested.env, key) == getattr(trained.env, key) for key in scene):
        rows = read_metrics(run)
        if learned:
            rows = [
                row | {name: row.get(f"{name}/{tested.env.task}", math.nan) for name in MEASURES}
                for row in rows
            ]
        write_curve(path, rows)


def _deciding(
    tested: TestedCheckpoint, protocol: Protocol, weights: str | None, materials: str
) -> dict[str, Any]:
    """Returns every setting that decides an episode, which a resumed evaluation must share."""
    from benchmark import provenance

    values = {"run": tested.run, "device": tested.device, "env": tested.env.to_json()}
    git = provenance.git_state()
    return values | {
        "training": asdict(tested.training),
        "weights": weights,
        "materials": materials,
        "protocol": protocol.to_json(),
        "git": None if git is None else asdict(git),
        "versions": dict(provenance.package_versions()),
    }


def _run_cells(
    policy: Any, name: str, tested: TestedCheckpoint, config: EvaluationConfig, view: dict[str, Any],
    video_folder: Path | None = None, finished: "FinishedCells | None" = None,
) -> tuple[list["EpisodeRecord"], dict[str, Any]]:  # fmt: skip
    """Evaluates every cell that is not finished; returns all records, and facts of the env."""
    from benchmark import runner, videos
    from roboverse_learn.progress import StageProgress

    protocol, sees = protocol_of(config), view["observation"] == "pixels"
    facts: dict[str, Any] = {"sees_images": sees}
    known = finished.records if finished else {}

    def make_env(cell: Cell) -> Any:
        spec = tested.env.replace(level=cell.level or 0, only=cell.only, materials=config.materials)
        num_envs = min(config.num_envs, protocol.episodes)
        env = spec.make(num_envs, split=cell.split, protocol_seed=protocol.seed, **view)
        facts["cameras"] = env.camera_names if sees else ()
        facts.update(max_episode_steps=env.task.max_episode_steps, control_hz=float(env.control_hz))
        return env

    def end_cell(cell: Cell, env: Any, records: list["EpisodeRecord"]) -> None:
        progress.print(f"{cell}: {sum(record.success for record in records)} of {len(records)} succeeded")
        if cell.split == "test" and config.videos and video_folder:
            videos.film_cell(
                policy, env, records, video_folder, control_hz=facts["control_hz"], count=config.videos
            )
        if finished:
            finished.add(cell, records)

    cells = protocol.cells()
    if all(cell in known for cell in cells):  # killed just before the results file was written
        make_env(cells[0]).close()
    with StageProgress("evaluating") as progress:
        done = itertools.count(sum(map(len, known.values())) + 1)
        records = runner.evaluate(
            policy,
            make_env,
            protocol,
            policy_name=name,
            on_episode=lambda _: progress.update(next(done), len(cells) * protocol.episodes, unit="episodes"),
            on_cell=end_cell,
            known=known,
        )
    return records, facts


def _result(
    tested: TestedCheckpoint, name: str, protocol: Protocol, checkpoint: "Checkpoint", command: str,
    records: list["EpisodeRecord"], facts: dict[str, Any],
) -> "Result":  # fmt: skip
    """Puts the result together."""
    from benchmark import provenance
    from benchmark.records import Result

    return Result(
        run=tested.run,
        created=provenance.now(),
        protocol=protocol,
        policy=name,
        train_tasks=tested.training.tasks,
        train_level=tested.training.level,
        train_only=tested.training.only,
        recipe=tested.training.recipe,
        seed=tested.training.seed,
        checkpoint=checkpoint,
        dataset_hash=tested.training.dataset_hash,
        demonstrations=tested.training.demonstrations,
        git=provenance.git_state(),
        command=provenance.command_line([f"roboverse_learn/{command}.py", *command_words()]),
        config=provenance.portable(tested.config),
        machine=provenance.machine(tested.device),
        versions=provenance.package_versions(),
        records=tuple(records),
        **facts,
    )


def _earlier(
    path: Path, weights: str | None, protocol: Protocol, tested: TestedCheckpoint, materials: str
) -> "Result | None":
    """Returns the result at ``path``, if it is of the same weights, protocol and environment."""
    from benchmark.provenance import package_versions
    from benchmark.results import read_result

    if not path.exists():
        return None
    result = read_result(path)
    now = (weights, protocol.hash, package_versions(), tested.env.replace(materials=materials))
    env = result.env.replace(cameras=tested.env.cameras)  # recorded by name, also where none was named
    if not result.sees_images:
        env = env.replace(image_size=tested.env.image_size)
    then = (result.checkpoint.hash, result.protocol.hash, dict(result.versions), env)
    return result if now == then else None


def _videos(path: Path) -> tuple[Path, ...]:
    from benchmark.results import video_dir

    return tuple(sorted(video_dir(path).glob("*.mp4")))


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("evaluate")
