"""``roboverse sweep policy=act,diffusion task=PickCube,StackCube level=0,3``: a run for every combination.

The runs share the GPUs of the machine, or are batch jobs of a cluster (``launcher=slurm``), and what several
of them learn from is collected once. A run that is complete is left alone, so the same command finishes a
sweep that was stopped. ``recipe=<name>`` makes the leaderboard's table.
"""

import itertools
import json
import logging
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import policies
from envs.core.atomic import write_file
from envs.core.errors import ConfigError, RoboVerseError, unknown_name
from envs.core.registry import plugins_word
from envs.tasks.suites import suite_tasks
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands.given_dataset import find_given
from roboverse_learn.commands.run_folder import CONFIG_FILE, default_folder, read_config, read_facts
from roboverse_learn.commands.tested_checkpoint import protocol_of
from roboverse_learn.commands.words_of_config import collect_words
from roboverse_learn.config.command_line_keys import UnknownKeyError, flat_keys, open_section, unknown_key
from roboverse_learn.config.compose import compose, configs_folder, values_of_key
from roboverse_learn.config.preflight import check_folders
from roboverse_learn.config.recipes import find_recipes, read_recipe, runs_in_order
from roboverse_learn.config.schema import SweepConfig, TrainRunConfig
from roboverse_learn.config.serialize import to_values
from roboverse_learn.config.suite_check import check_suite
from roboverse_learn.launch import make_launcher
from roboverse_learn.launch.base import Job

log = logging.getLogger(__name__)

_LOGS = "sweep-logs"
_PROGRESS = "progress.txt"


class SweepError(RoboVerseError):
    """Some runs of a sweep failed."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """A sweep, every word of which has been checked.

    Attributes:
        config: How it runs.
        runs: Words of ``roboverse train`` and what they mean, in the order given.
    """

    config: SweepConfig
    runs: tuple[tuple[tuple[str, ...], TrainRunConfig], ...]


def plan(words: Sequence[str]) -> Sweep:
    """Reads the words of a command line: keys of the sweep, and keys of ``train`` with one or more values.

    Raises:
        RoboVerseError: as :func:`roboverse_learn.config.compose.compose`, for any of the runs.
    """
    own = flat_keys(to_values(SweepConfig()))
    typed = [word.partition("=")[0] for word in words]
    if "run" in typed:
        raise ConfigError(
            "run= names the folder of one run, and a sweep names its runs itself. Leave it out, or give "
            "runs_dir=<folder>."
        )
    is_own = [key in own or open_section(key) in own for key in typed]
    config = compose("sweep", [word for word, mine in zip(words, is_own, strict=True) if mine])
    check_suite(config.suite, task=",".join(word[5:] for word in words if word.startswith("task=")))
    tasks = suite_tasks(config.suite) if config.suite else ()
    if config.recipe:
        rest = tuple(word for word, mine in zip(words, is_own, strict=True) if not mine)
        return _checked(
            config, _runs_of_recipes(replace(config, suite="", tasks=tasks or config.tasks), rest)
        )
    choices = [values_of_key(word) for word, mine in zip(words, is_own, strict=True) if not mine]
    choices += [[f"task={task}" for task in tasks]] if tasks else []
    combinations = dict.fromkeys(itertools.product(*choices))
    runs = []
    for each in combinations:
        run = _composed(each)
        check_folders(run)
        given = find_given(run)
        runs.append((each, given.config if given else run))
    return _checked(config, tuple(runs))


def _composed(words: Sequence[str]) -> TrainRunConfig:
    """Returns the configuration of a run; a key that it has not may be a misspelt one of the sweep."""
    try:
        return compose("train", words)
    except UnknownKeyError as error:
        keys = [*flat_keys(to_values(SweepConfig())), *(key for key in error.keys if key != "run")]
        raise unknown_key("sweep", error.key, dict.fromkeys(keys)) from None


def _checked(config: SweepConfig, runs: tuple[tuple[tuple[str, ...], TrainRunConfig], ...]) -> Sweep:
    if not runs:
        raise ConfigError("The sweep has no run: a key was given without a value. Give each at least one.")
    return Sweep(config, runs)


def _runs_of_recipes(
    config: SweepConfig, rest: tuple[str, ...]
) -> tuple[tuple[tuple[str, ...], TrainRunConfig], ...]:
    """Returns the runs of the leaderboard's table; ``rest`` is typed beside the recipe in each."""
    folder = configs_folder() / "recipe"
    recipes = find_recipes(config.recipe, folder)
    of_policy = {recipe: str(read_recipe(recipe, folder)[1]["policy_name"]) for recipe in recipes}
    for policy in config.policies:
        if policy not in of_policy.values():
            raise unknown_name(f"policy of recipe={config.recipe}", policy, of_policy.values())
    recipes = [each for each in recipes if not config.policies or of_policy[each] in config.policies]
    each_run = runs_in_order(recipes, config.tasks, config.levels, config.seeds)
    runs = tuple(((*words, *rest), _composed([*words, *rest])) for words in each_run)
    for _, run in runs:
        check_folders(run)
    return runs


def sweep(the_sweep: Sweep) -> Any:
    """Does every run that is not complete; returns a printable report, also where the board is not written.

    Raises:
        SweepError: Runs failed; the others were done all the same.
    """
    jobs, complete = make_jobs(the_sweep)
    if the_sweep.config.dry_run and the_sweep.config.recipe:
        return table(the_sweep)
    if the_sweep.config.dry_run:
        word = plugins_word()
        named = f" {shlex.quote(word)}" if word else ""
        return "\n".join(
            [f"# complete: {folder}" for folder in complete] + [job.command + named for job in jobs]
        )
    config = the_sweep.config
    launcher = make_launcher(config.launcher, config.launcher_settings, config.jobs_per_gpu)
    _, first = the_sweep.runs[0]
    logs = Path(first.runs_dir) / _LOGS
    logs.mkdir(parents=True, exist_ok=True)
    started, ended = time.monotonic(), itertools.count(1)
    log.info("%d processes. Their logs: %s", len(jobs), logs)

    def on_end(job: Job, code: int | None) -> None:
        what = "was left out" if code is None else "done" if code == 0 else f"FAILED with code {code}"
        minutes = (time.monotonic() - started) / 60.0
        log.info("%3d of %d, %.1f min: %s %s", next(ended), len(jobs), minutes, job.name, what)
        write_file(logs / _PROGRESS, f"{table(the_sweep)}\n\nLast: {job.name} {what}\n".encode())

    codes = launcher.run(jobs, logs, on_end)
    trained = [codes[job.name] for job in jobs if job.words[0] == "train"]
    report: Any = f"{len(the_sweep.runs)} runs are complete, {len(complete)} of them were before."
    # Runs that end together may each have missed the other's result; runs that failed have none.
    if Path(first.results_dir).is_dir() and (not trained or 0 in trained):
        report = _with_leaderboard(Path(first.results_dir), report)
    bad = [job for job in jobs if codes[job.name] != 0]
    if bad:
        rows = [f"{job.name}: {_last_line(logs / f'{job.name}.log')}" for job in bad]
        said = f"{len(bad)} of {len(jobs)} processes failed. The same command tries them again."
        raise SweepError("\n".join(filter(None, [said, *rows, getattr(report, "failure", "")])))
    return report


def _with_leaderboard(results_dir: Path, report: str) -> Any:
    """Writes the leaderboard; returns the report, with why the leaderboard was not written if it was not."""
    from rich.console import Group
    from rich.text import Text

    from roboverse_learn.leaderboard import report_with_leaderboard

    return report_with_leaderboard(results_dir, (), lambda _: Group(Text(report)))


def make_jobs(the_sweep: Sweep) -> tuple[list[Job], list[Path]]:
    """Returns the processes that are still to do, and the folders of complete runs.

    A collection comes just before the first training that needs it, so that an interruption leaves runs.

    Raises:
        ConfigError: Two runs would share a folder.
    """
    collections: dict[Path, Job] = {}
    jobs: list[Job] = []
    complete = []
    of_folder: dict[Path, tuple[str, ...]] = {}
    for words, config in the_sweep.runs:
        folder = default_folder(config)
        _check_is_another(words, of_folder.setdefault(folder, words), folder)
        if _is_complete(folder, config):
            complete.append(folder)
            continue
        after = None
        if policies.learns_from(config.policy_name) == "dataset" and not config.dataset:  # one given is there
            dataset = dataset_folder(config)
            name = f"collect-{config.env.task}-{dataset.name}".replace("/", "-")
            if dataset not in collections:
                collections[dataset] = Job(name, ("collect", *collect_words(config)))
                jobs.append(collections[dataset])
            after = collections[dataset].name
        name = f"train-{config.env.task}-{config.policy_name}-{folder.name}".replace("/", "-")
        jobs.append(Job(name, ("train", *words), after))
    return jobs, complete


def _check_is_another(words: tuple[str, ...], first: tuple[str, ...], folder: Path) -> None:
    """Checks that a run is the first of its folder."""
    if words is not first:
        keys = ", ".join(word.partition("=")[0] for word in words if word not in first)
        raise ConfigError(
            f"'{' '.join(first)}' and '{' '.join(words)}' would share the folder '{folder}'. Give {keys} one "
            "value, and start each further run by a command of its own, with run=<folder>."
        )


def table(the_sweep: Sweep) -> str:
    """Returns a line per run, in their order, with its state: done, started or open."""
    lines, counts = [], dict.fromkeys(("done", "started", "open"), 0)
    for _, config in the_sweep.runs:
        folder = default_folder(config)
        started = "started" if (folder / CONFIG_FILE).exists() else "open"
        state = "done" if _is_complete(folder, config) else started
        counts[state] += 1
        what = (config.env.task, config.recipe or config.policy_name, config.env.level, config.seed)
        lines.append("{:<8} {:<24} {:<16} level {}  seed {}".format(state, *what))
    return "\n".join([*lines, ", ".join(f"{count} {state}" for state, count in counts.items())])


def _is_complete(folder: Path, config: TrainRunConfig) -> bool:
    """Whether a run was evaluated as this configuration wants it."""
    if config.recipe:  # its result alone counts: runs need not be kept
        return _has_result(folder.name, config)
    if not (folder / CONFIG_FILE).exists():
        return False
    facts = read_facts(folder, "evaluate")
    same = to_values(replace(read_config(folder), tasks_at_once=config.tasks_at_once)) == to_values(config)
    results = facts.get("results") or [facts.get("result", "")]  # runs that are older name one
    return same and facts.get("status") == "done" and all(Path(str(each)).is_file() for each in results)


def _has_result(run: str, config: TrainRunConfig) -> bool:
    """Whether a run of a recipe has a result; the run's name follows from all that decides it."""
    protocol = protocol_of(config.evaluate)
    for path in (Path(config.results_dir) / protocol.version / config.env.task).glob(f"*/{run}.json"):
        try:
            document = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        if (document.get("recipe"), document.get("protocol_hash")) == (config.recipe, protocol.hash):
            return True
    return False


def _last_line(log_file: Path) -> str:
    """The last line of a log, and where the rest is."""
    try:
        lines = log_file.read_text(errors="replace").replace("\r", "\n").split("\n")
    except OSError:
        return "it did not start"
    last = next((line for line in reversed(lines) if line.strip()), "no output")
    return f"{last.strip()} ({log_file})"
