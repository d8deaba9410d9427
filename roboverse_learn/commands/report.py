"""Final output of the commands: tables and the paths of written files, as rich renderables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from envs.randomization.splits import SPLIT_NAMES
from envs.spec import EnvSpec
from roboverse_learn.progress import clock

if TYPE_CHECKING:
    from benchmark.instruction_scores import PairedComparison
    from benchmark.records import CellSummary, Result
    from benchmark.suites import SuiteCell
    from roboverse_learn.commands.outcomes import Evaluation, TrainedRun
    from roboverse_learn.data.collection.collect import CollectionSummary
    from roboverse_learn.data.importers.verdicts import ImportSummary

_SHOWN_VIDEOS = 8
_SHOWN_SKIPPED = 20


class UnfinishedReport(Group):
    """A report of work that is done, and an error that came after it.

    Attributes:
        failure: The error, which the command ends with.
    """

    def __init__(self, report: Group, failure: str) -> None:
        super().__init__(report)
        self.failure = failure


class WarnedReport(Group):
    """A report of work that is done, and a warning.

    Attributes:
        warning: What the user should know; the command's exit code is 0 all the same.
    """

    def __init__(self, report: Group, warning: str) -> None:
        super().__init__(report)
        self.warning = warning


def train_report(run: "TrainedRun") -> Group:
    """The whole loop: what each stage did, the table of success, and where everything is.

    That no leaderboard could be written is a warning, so that one damaged file of another run among the
    results does not make every run of a sweep a failure.
    """
    trained, dataset, stages = run.trained, run.dataset, run.stages
    loss = "" if trained.loss is None else f", loss {trained.loss:.4f}"
    times = ", ".join(
        f"{name} {clock(facts['seconds'])}" for name, facts in stages.items() if "seconds" in facts
    )
    report = Group(
        *(
            []
            if dataset is None
            else [unbroken(dataset) if isinstance(dataset, str) else _collected(dataset)]
        ),
        Text(f"Trained {trained.steps:,} steps (stopped by {trained.stopped_by.replace('_', ' ')}){loss}."),
        *_tables(run.evaluations),
        *([unbroken(run.note)] if run.note else []),
        listed_paths(
            {"run": run.folder, "checkpoint": trained.checkpoint, "curves": trained.plot}
            | _evaluation_paths(run.evaluations, run.board)
        ),
        Text(f"Done in {clock(run.seconds)}: {times}."),
        listed_paths({"See the policy": run.gif} | pages_to_open(run.board)),
    )
    return WarnedReport(report, run.board_failure) if run.board_failure else report


def collection_report(dataset: "CollectionSummary") -> Group:
    """Summary of a collection, and its path."""
    return Group(
        _collected(dataset),
        Text(
            f"{dataset.num_frames:,} frames, {clock(dataset.wall_time_s)}, hash {dataset.dataset_hash[:16]}."
        ),
        listed_paths({"dataset": dataset.root}),
    )


def evaluation_report(evaluations: Sequence["Evaluation"], board: Mapping[str, Path]) -> Group:
    """The table of success of every task, and where the results are."""
    return Group(
        *_tables(evaluations),
        listed_paths(_evaluation_paths(evaluations, board)),
        listed_paths(pages_to_open(board)),
    )


def leaderboard_report(board: Mapping[str, Path], removed_videos: int | None = None) -> Group:
    """Paths of the leaderboard, and how many videos were removed, if any were to be."""
    removed = [] if removed_videos is None else [Text(f"Removed {removed_videos} videos.")]
    return Group(*removed, listed_paths(board_paths(board)))


def replay_report(summary: Mapping[str, Any], path: Path, page: Mapping[str, Path]) -> Group:
    """Outcomes of replayed episodes, and their path."""
    pair = f"{summary['recorded_in']} to {summary['replayed_in']}"
    lines = [f"{summary['task']}, {pair}, {summary['num_episodes']} episodes:"]
    for way, found in summary["replays"].items():
        last = {
            name: values["last"]["median"] for name, values in found["drift"].items() if name.endswith("_m")
        }
        drift = ", ".join(
            f"{name.removesuffix('_m').replace('_', ' ')} {m:.2g} m" for name, m in last.items()
        )
        checks = found["checks"]
        lines.append(
            f"  by {way}: {100 * found['success_rate']:.1f} % success (recorded: "
            f"{100 * found['recorded_success_rate']:.1f} %), the success condition agrees at "
            f"{checks['agree']} of {checks['asked']} moments; median drift at the end: {drift}"
        )
    plots = [each for name, each in page.items() if name.startswith("plot")]
    return Group(
        Text("\n".join(lines)), listed_paths({"summary": path, "table": page["table"], "plots": plots})
    )


def conservation_report(cells: Sequence[Sequence[str]], written: Mapping[str, Path]) -> Group:
    """The table of what each simulator keeps, its head first, and where everything is."""
    head, *rows = cells
    table = Table(*head)
    for row in rows:
        table.add_row(*row)
    plots = [path for name, path in written.items() if name.startswith("plot")]
    return Group(table, listed_paths({"table": written["table"], "plots": plots}))


def success_table(evaluation: "Evaluation") -> Table:
    """Success by level and split, with Wilson's 95 % interval; the test split is the headline."""
    result = evaluation.result
    episodes = f"{result.protocol.episodes} episodes"
    how = "without training" if result.checkpoint.hash is None else f"trained on {_trained_on(result)}"
    title = f"{in_scene(result.env.task, result.env)}, {result.policy}, {how}: success in {episodes}"
    table = Table(
        title=title,
        title_justify="left",
    )
    splits = sorted(result.protocol.splits, key=SPLIT_NAMES.index, reverse=True)
    for title in ("evaluated on", *(f"{split} split" for split in splits), "varied", "not shown"):
        table.add_column(title, justify="right" if title.endswith("split") else "left")
    by_condition: dict[str, list[CellSummary]] = {}
    for cell in result.cells():
        by_condition.setdefault(cell.cell.condition, []).append(cell)
    for condition, cells in by_condition.items():
        by_split = {cell.cell.split: cell for cell in cells}
        rates = [rate_text(by_split[split]) for split in splits]
        table.add_row(
            condition, *rates, ", ".join(cells[0].channels), ", ".join(cells[0].not_shown) or "nothing"
        )
    return table


def _trained_on(result: "Result") -> str:
    """Returns what a policy was trained on: ``level 0 together with StackCube``."""
    from benchmark.leaderboard.rows import is_of_other_task, learned_tasks

    level = "an unknown level" if result.train_level is None else f"level {result.train_level}"
    trained = f"{result.train_only} alone" if result.train_only else level
    others = ", ".join(task for task in learned_tasks(result) if task != result.env.task)
    if is_of_other_task(result):
        return f"{others} at {trained}, not on {result.env.task}"
    return f"{trained} together with {others}" if others else trained


def in_scene(what: str, env: EnvSpec) -> str:
    """Returns what was tested, and where unusual: ``PickCube (robot=ur5e, simulator=sapien)``."""
    usual = EnvSpec()
    keys = [key for key in ("robot", "simulator", "renderer") if getattr(env, key) != getattr(usual, key)]
    return what + (f" ({', '.join(f'{key}={getattr(env, key)}' for key in keys)})" if keys else "")


def instruction_table(evaluation: "Evaluation") -> Table:
    """How much the instruction matters: success with the right one, in each test, and the difference."""
    from benchmark.instruction_scores import instruction_scores

    result = evaluation.result
    where = in_scene(result.env.task, result.env)
    title = f"{where}, {result.policy}: success in the task when it is asked for otherwise, or not"
    table = Table(title=title, title_justify="left")
    for column in ("instruction", "split", "right instruction", "this one", "difference"):
        table.add_column(column, justify="left" if column in ("instruction", "split") else "right")
    for score in instruction_scores(result.records):
        words = (score.instruction_test.replace("_", " "), score.split)
        table.add_row(*words, *_compared(score.right_rate, score.test_rate, score))
    return table


def wording_table(evaluations: Sequence["Evaluation"]) -> Table | None:
    """Success with known and with held-out wordings, by task and over all; None where neither was tested."""
    from benchmark.instruction_scores import wording_gaps

    results = [each.result for each in evaluations]
    tested = [(result, gaps) for result in results if (gaps := wording_gaps(result.records))]
    if not tested:
        return None
    rows = [(result.env.task, gaps) for result, gaps in tested]
    if len(tested) > 1:
        rows.append(("all", wording_gaps(record for result, _ in tested for record in result.records)))
    title = f"{tested[0][0].policy}: success with known wordings and with held-out ones"
    table = Table(title=title, title_justify="left")
    for column in ("task", "wording", "split", "known", "held out", "difference"):
        table.add_column(column, justify="left" if len(table.columns) < 3 else "right")
    for task, gaps in rows:
        for gap in gaps:
            words = (gap.wording.replace("_", " "), gap.split)
            table.add_row(task, *words, *_compared(gap.known_rate, gap.held_out_rate, gap))
    return table


def _compared(one: float, other: float, comparison: "PairedComparison") -> tuple[str, str, str]:
    """Two success rates and their difference: ``90 %``, ``75 %``, ``+15 [8, 22]``."""
    interval = f"[{100 * comparison.ci_low:.0f}, {100 * comparison.ci_high:.0f}]"
    return f"{100 * one:.0f} %", f"{100 * other:.0f} %", f"{100 * comparison.difference:+.0f} {interval}"


def _tables(evaluations: Sequence["Evaluation"]) -> list[Table]:
    """The table of success of every task, those of its instruction tests, and that of held-out wordings."""
    tested = [each for each in evaluations if each.result.protocol.instructions]
    worded = wording_table(tested)
    tables = [*map(success_table, evaluations), *map(instruction_table, tested)]
    return tables if worded is None else [*tables, worded]


def rate_text(cell: "CellSummary | SuiteCell") -> str:
    """Success rate and its interval: ``93 % [86, 97]``."""
    return f"{100 * cell.success_rate:.0f} % [{100 * cell.ci_low:.0f}, {100 * cell.ci_high:.0f}]"


def _collected(dataset: "CollectionSummary") -> Text:
    if dataset.imported is not None:
        return _imported(dataset, dataset.imported)
    said = f"; {dataset.outcome}" if dataset.outcome else ""
    return Text(f"Collected {dataset.num_episodes} demonstrations{said}.")


def _imported(dataset: "CollectionSummary", imported: "ImportSummary") -> Text:
    """Numbers of demonstrations that pass each replay, that the dataset has, and that were skipped."""
    by_states = f"{imported.count('states')} of {imported.num_with_states} pass by states"
    lines = [
        f"Read {len(imported.read)} demonstrations of {imported.source}: "
        f"{by_states if imported.num_with_states else 'none has recorded states'}, "
        f"{imported.count('controls')} of {len(imported.read)} pass by controls. "
        f"Imported {dataset.num_episodes} by {imported.replay}."
    ]
    if imported.num_with_states and imported.num_said:
        lines.append(
            f"By states, our checker agrees with {imported.num_agreeing} of the {imported.num_said} outcomes "
            "that the files name."
        )
    if imported.skipped:
        lines.append(f"Skipped {len(imported.skipped)}:")
    lines += [f"  {v.file} {v.name}".rstrip() + f": {v.error}" for v in imported.skipped[:_SHOWN_SKIPPED]]
    if len(imported.skipped) > _SHOWN_SKIPPED:
        lines.append(f"  … and {len(imported.skipped) - _SHOWN_SKIPPED} more, named in meta/import.json")
    return unbroken("\n".join(lines))


def _evaluation_paths(evaluations: Sequence["Evaluation"], board: Mapping[str, Path]) -> dict[str, Any]:
    videos = [video for each in evaluations for video in each.videos]
    return {"result": [each.path for each in evaluations], "videos": videos} | board_paths(board)


def board_paths(board: Mapping[str, Path]) -> dict[str, Any]:
    """Files of the leaderboard, by what they are called in a report."""
    plots = [path for name, path in board.items() if name.startswith("plot")]
    names = {"html": "page", "studies html": "studies", "instructions html": "instructions"}
    names |= {"markdown": "table", "json": "leaderboard"}
    return {title: board[name] for name, title in names.items() if name in board} | {"plots": plots}


def pages_to_open(board: Mapping[str, Path]) -> dict[str, Any]:
    """The pages that the results of a report are on; the board where it is not known."""
    pages = [board[kind] for kind in ("result html", "result studies html") if kind in board]
    return {"Open in a browser": pages or board.get("html")}


def listed_paths(paths: Mapping[str, Any]) -> Group:
    """Names and paths, a path in a line; a long one is not broken, so that it can be copied."""
    lines: list[tuple[str, str]] = []
    for name, value in paths.items():
        several: Sequence[Any] = value if isinstance(value, list | tuple) else [value]
        shown = [str(path) for path in several if path is not None]
        more = len(shown) - _SHOWN_VIDEOS
        if more > 0:
            shown = [*shown[:_SHOWN_VIDEOS], f"… and {more} more beside them"]
        lines += [(name if index == 0 else "", path) for index, path in enumerate(shown)]
    width = max((len(name) for name, _ in lines), default=0)
    return Group(*(unbroken(f"{name:{width}}  {path}") for name, path in lines))


def unbroken(text: str) -> Text:
    """Returns lines that may name paths: the terminal alone breaks them, so that a path can be copied."""
    return Text(text, no_wrap=True, overflow="ignore")
