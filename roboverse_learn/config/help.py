"""Text of ``--help`` and ``roboverse list``, from registries, dataclasses and docstrings."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import policies
from envs.core.docstrings import plain
from envs.core.errors import ConfigError, unknown_name
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.suites import PAPER, SUITES, suite_tasks
from roboverse_learn.config.command_line_keys import at, flat_keys, typed_key
from roboverse_learn.config.compose import preset_names
from roboverse_learn.config.path_keys import check_path
from roboverse_learn.config.scenario_overrides import SECTION, scenario_keys
from roboverse_learn.config.schema import COMMANDS, baselines
from roboverse_learn.config.serialize import default_values
from roboverse_learn.config.value_text import as_text

SUMMARIES = {
    "train": "collect what is missing, train, evaluate over the levels, write the leaderboard",
    "collect": "collect demonstrations into a LeRobot dataset: of the expert, a policy, files, or augmented",
    "teleoperate": "steer the hand in a browser; episodes become a LeRobot dataset",
    "sweep": "train once for every combination of several values, over the GPUs of this machine or a cluster",
    "evaluate": "evaluate a checkpoint, the expert or a rule over levels and splits",
    "replay": "replay recorded states and controls in another simulator, and say how far apart they are",
    "view": "show an episode in the browser: 3D scene over time, camera images, randomization draws",
    "conservation": "measure what each simulator keeps of momentum, angular momentum and kinetic energy",
    "leaderboard": "write tables, plots and the page from the result files",
    "check": "look at the contracts of a task, a policy or a robot, also one of your own",
    "new": "write a package with a working task, policy or robot to start from",
    "convert": "write a robot as URDF or USD, its meshes beside it",
    "export": "write a checkpoint as a folder that lerobot-rollout runs on a real robot",
    "publish": "upload a checkpoint or a dataset to the Hugging Face hub, with a page about it",
    "dataset": "merge datasets, say what one holds, or get one of the Hugging Face hub",
    "assets": "say what tasks need that is not part of this, of what licence; download it",
    "speed": "measure the speed of the parts, each against its reference",
    "doctor": "print what this machine has and what works on it, for a bug report",
    "list": "list tasks with all facts, suites, policies, simulators, renderers, robots, levels and more",
}

EXAMPLES = {
    "train": (
        "roboverse train policy=act task=PickCube preset=quick",
        "roboverse train policy=diffusion task=PickCube train.steps=50000 num_demos=500",
        "roboverse train policy=act task=StackCube preset=quick dry_run=true   (says what it would do)",
        "roboverse train run=runs/PickCube/act/<run>   (continues a run)",
    ),
    "collect": (
        "roboverse collect task=PickCube num_demos=200 level=0",
        "roboverse collect suite=maniskill num_demos=200   (a dataset for each task)",
        "roboverse collect source=augment from=datasets/PickCube/<name> num_demos=1000",
    ),
    "teleoperate": (
        "roboverse teleoperate task=PickCube num_demos=20",
        "roboverse teleoperate task=StackCube host=0.0.0.0 operators=2 https=true",
        "roboverse teleoperate checkpoint=runs/PickCube/act/<run>   (a policy acts until you take over)",
    ),
    "sweep": (
        "roboverse sweep policy=act,diffusion task=PickCube,StackCube level=0,3 preset=gpu",
        "roboverse sweep policy=act task=PickCube seed=range(3) num_demos=50,200,1000 dry_run=true",
        "roboverse sweep policy=act suite=paper level=0,3   (every task of a suite)",
        "roboverse sweep recipe=v1 launcher=slurm launcher_settings.partition=gpu   (on a cluster)",
        "Any key of train may be given, with one value or with several.",
    ),
    "evaluate": (
        "roboverse evaluate checkpoint=runs/PickCube/act/<run> levels=[0,1,2,3] episodes=100",
        "roboverse evaluate checkpoint=… levels=[] alone=[camera,lighting] splits=[test]",
        "roboverse evaluate policy=random task=PickCube   (a baseline; also zero, hold, expert)",
        "roboverse evaluate checkpoint=… suite=paper   (every task of a suite, and their mean)",
        "roboverse evaluate checkpoint=… suite=calvin chains=1000   (chains of five instructions)",
    ),
    "replay": ("roboverse replay dataset=datasets/PickCube/<name> simulator=mujoco_warp episodes=50",),
    "view": (
        "roboverse view task=PickCube level=3   (the expert)",
        "roboverse view dataset=datasets/PickCube/<name> episode=4",
        "roboverse view result=results/v2/PickCube/act/<run>.json file=episode.rrd",
    ),
    "conservation": ("roboverse conservation simulators=[mujoco,mujoco_warp]",),
    "leaderboard": ("roboverse leaderboard results_dir=results",),
    "check": (
        "roboverse check task=PickCube",
        "roboverse check task=LiftBlock plugins=[lift_block] simulator=mujoco_warp",
        "roboverse check policy=act task=PickCube   (also robot=franka)",
    ),
    "new": (
        "roboverse new task name=LiftBlock   (or: roboverse new task LiftBlock)",
        "roboverse new policy name=my_cnn out=folder",
        "roboverse new robot name=my_arm",
    ),
    "convert": (
        "roboverse convert robot=franka to=usd out=franka_usd",
        "roboverse convert robot=robot.xml to=urdf",
    ),
    "export": ("roboverse export checkpoint=runs/so101/pick_cube/act/<run> to=so101_follower",),
    "publish": (
        "roboverse publish checkpoint=runs/PickCube/act/<run> to=<owner>/<name>",
        "roboverse publish dataset=datasets/PickCube/<name> to=<owner>/<name> private=true",
        "roboverse publish checkpoint=runs/PickCube/act/<run> to=<owner>/<name> dry_run=true",
    ),
    "assets": (
        "roboverse assets list   (or: roboverse assets list libero)",
        "roboverse assets get calvin",
        "roboverse assets get calvin assets_dir=folder   (checks a copy; downloads nothing)",
    ),
    "dataset": (
        "roboverse dataset info dataset=datasets/PickCube/<name>",
        "roboverse dataset merge from=[datasets/<a>,datasets/<b>] out=datasets/all",
        "roboverse dataset get from=lerobot/pusht",
    ),
    "doctor": (
        "roboverse doctor",
        "roboverse doctor speed=false   (a quick look)",
        "roboverse doctor json=true   (or --json)",
    ),
    "list": (
        "roboverse list   (everything)",
        "roboverse list policies robots   (some kinds)",
        "roboverse list tasks libero drawer   (tasks that have all of these words)",
        "roboverse list runs   (what is in runs_dir=runs: state, steps, success)",
    ),
}


def overview() -> str:
    """Returns the text of ``roboverse --help``."""
    commands = "\n".join(f"  {name:<12} {summary}" for name, summary in SUMMARIES.items())
    return (
        "RoboVerse Learn: demonstrations, policies, and a benchmark of four generalization levels.\n\n"
        "Usage: roboverse <command> [key=value ...]\n\n"
        f"Commands:\n{commands}\n\n"
        f"{listing()}\n\n"
        "Main keys of train, with their defaults:\n"
        f"{_rows(key_rows('train', ('policy.', 'train.')))}\n\n"
        "A key may be shortened to its last part where that is unambiguous. Every key of a command and of\n"
        "its policy: roboverse <command> --help [policy=<name>]\n"
        "plugins=[my_module] imports modules first, which register tasks, robots, policies of your own.\n\n"
        "Start with: roboverse train policy=act task=PickCube preset=quick"
    )


def command_help(command: str, policy: str = "act") -> str:
    """Returns the text of ``roboverse <command> --help``.

    Args:
        command: Name of the command.
        policy: The policy whose keys are listed.
    """
    examples = "\n".join(f"  {line}" for line in EXAMPLES[command])
    about = f"roboverse {command}: {SUMMARIES[command]}."
    if command not in COMMANDS:  # it takes words
        return f"{about}\n\nUsage:\n{examples}"
    parts = [about, f"Usage: roboverse {command} [key=value ...]\n{examples}"]
    if command not in ("leaderboard", "convert", "export", "publish", "doctor", "new"):
        parts.append(listing())
    parts.append(f"Keys, with their defaults:\n{_rows(key_rows(command, policy=policy))}")
    return "\n\n".join(parts)


def listing(datasets_dir: str | None = None, kinds: Sequence[str] = (), words: Sequence[str] = ()) -> str:
    """Returns what has a name; with a folder of datasets, also the names and all facts of the tasks.

    Args:
        datasets_dir: Where demonstrations are counted, or None for a help text: of what is many, the number.
        kinds: Some of :data:`KINDS`; empty is all.
        words: Words that a listed task has, in its name, its words or its source.
    """
    return "\n".join(f"{kind.capitalize()}:\n{_named(kind, datasets_dir, words)}" for kind in kinds or KINDS)


def list_command(words: Sequence[str]) -> str:
    """Returns the text of ``roboverse list [kind ...] [word ...] [key=<folder>]``.

    Words after ``tasks`` choose tasks that have all of them: ``roboverse list tasks libero drawer``. Runs are
    listed where they are named alone.

    Raises:
        UnknownNameError: if another kind or key is given.
        ConfigError: if no task has the words, or a folder's name is empty.
    """
    kinds, chosen, folders = [], [], {}
    for word in words:
        key, is_setting, value = word.partition("=")
        if is_setting:
            check_path(key, key, value)
            folders[key] = value
        elif word in KINDS or (word == RUNS and not kinds):
            kinds.append(word)
        elif kinds == ["tasks"]:
            chosen.append(word)
        else:
            raise unknown_name("kind of thing to list", word, (*KINDS, RUNS))
    takes = "runs_dir" if RUNS in kinds else "datasets_dir"
    for key in folders:
        if key != takes:
            raise unknown_name(f"key of list{f' {RUNS}' if RUNS in kinds else ''}", key, (takes,))
    if RUNS not in kinds:
        return listing(folders.get(takes, "datasets"), kinds, chosen)
    if kinds != [RUNS]:
        raise ConfigError(f"Runs are listed alone: roboverse list {RUNS}.")
    runs = importlib.import_module("roboverse_learn.commands.run_list")
    return runs.runs_in_detail(Path(folders.get(takes, "runs")))


PRESETS = {
    "full": "the full size, for a GPU (default)",
    "gpu": "one cell of the leaderboard in about ten minutes of one data-centre GPU",
    "locomotion": "the full size, with PPO's horizon and noise for robots on legs",
    "pixels": "the full size, with PPO learning from images of 64 pixels a side",
    "quick": "the whole loop on two CPU cores, with ACT in six to thirteen minutes",
}


def _levels() -> list[tuple[str, str]]:
    """Returns each level with its channels; a named one as it is given."""
    levels = importlib.import_module("envs.randomization.levels")
    numbered = [(str(level), " + ".join(levels.channels_of(level))) for level in levels.LEVELS]
    named = levels.NAMED_LEVELS
    return [*numbered, *((f"only={name}", named.entry(name).summary) for name in named)]


KINDS: Mapping[str, str | Callable[[], list[tuple[str, str]]]] = {
    "tasks": "envs.tasks:TASKS",
    "suites": lambda: [
        (name, f"{len(suite_tasks(name)):>3} tasks  {SUITES.entry(name).summary}") for name in SUITES
    ],
    "protocols": "envs.tasks.protocols:PROTOCOLS",
    "policies": lambda: [(name, policies.summary(name)) for name in policies.names()],
    "simulators": "envs.simulators:HANDLERS",
    "renderers": "envs.simulators:RENDERERS",
    "robots": "envs.robots:ROBOTS",
    "channels": "envs.randomization.channels:CHANNELS",
    "levels": _levels,
    "sources": "roboverse_learn.data.sources:SOURCES",
    "launchers": "roboverse_learn.launch:LAUNCHERS",
    "presets": lambda: [(name, PRESETS.get(name, "")) for name in preset_names()],
}
"""Sections of ``roboverse list``, in order: a registry, or what returns the rows."""

RUNS = "runs"
"""What ``roboverse list`` shows where it is named alone, since it is of a folder, not of the installation."""

_MANY = {"tasks": (TASKS.names, PAPER[:3]), "suites": (SUITES.names, ("paper", "libero", "metaworld"))}
"""Kinds of which a help text gives the number and a few names."""


def _named(kind: str, datasets_dir: str | None, words: Sequence[str] = ()) -> str:
    """Returns the lines of one kind, without its heading."""
    if kind in _MANY and datasets_dir is None:
        names, examples = _MANY[kind]
        return f"  {len(names())} in all, such as {', '.join(examples)}. Their names: roboverse list {kind}"
    if kind == "tasks":
        tasks = importlib.import_module("roboverse_learn.commands.task_list")
        folder = Path(datasets_dir or "")
        return tasks.tasks_with(words, folder) if words else tasks.tasks_in_detail(folder)
    rows = KINDS[kind]
    if isinstance(rows, str):
        registry = pkgutil.resolve_name(rows)
        return _rows([(name, registry.entry(name).summary) for name in registry])
    return _rows(rows())


def key_rows(command: str, skip: tuple[str, ...] = (), policy: str = "act") -> list[tuple[str, str]]:
    """Returns rows of ``key=default`` and the line of its dataclass's docstring."""
    values = default_values(command, policy)
    about = dict(_attributes(COMMANDS[command], policy))
    rows = []
    for key in flat_keys(values):
        if key == "policy_name":
            names = {"evaluate": baselines(), "check": policies.names("dataset")}.get(command)
            what = about[key] if names else "Policy:"
            listed = ", ".join(names or policies.names())
            rows.append((f"policy={values[key]}", f"{what.rstrip('.:')}: {listed}."))
        elif not any(key.startswith(start) for start in skip):
            rows.append((f"{typed_key(key)}={_shown(at(values, key))}", about.get(key, "")))
            rows += _scene_rows() if key == SECTION and not skip else []
    return rows


_NOT_LISTED = ("robots", "objects", "appearance.cameras", "appearance.furniture")
"""Parts of a scene with too many keys for a listing."""


def _scene_rows() -> list[tuple[str, str]]:
    """Returns rows of the keys of a scene, whose defaults are the task's."""
    rows = [(f"{SECTION}.{part}.<name>.*=", "Every field, as in envs/scenario.") for part in _NOT_LISTED]
    hidden = tuple(f"{SECTION}.{part}." for part in _NOT_LISTED)
    listed = {key: of for key, of in scenario_keys().items() if not key.startswith(hidden)}
    return [(f"{key}=", dict(documented(cls)).get(name, "")) for key, (cls, name) in listed.items()] + rows


def _attributes(cls: type, policy: str, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yields each dotted key of a dataclass with its line of the ``Attributes`` section."""
    yield from ((prefix + name, text) for name, text in documented(cls))
    for name, item in getattr(cls, "__dataclass_fields__", {}).items():
        nested = policies.config_class(policy) if name == "policy" else item.type
        if name == "env":
            yield from documented(EnvSpec)
        elif is_dataclass(nested) and isinstance(nested, type):
            yield from _attributes(nested, policy, f"{prefix}{name}.")


def documented(cls: type) -> Iterator[tuple[str, str]]:
    """Yields each attribute of a dataclass and of its bases with its text in the docstring."""
    for base in reversed(cls.__mro__):
        docstring = inspect.cleandoc(base.__doc__ or "")
        for name, text in re.findall(r"^    (\w+): (.+(?:\n {8,}.+)*)", docstring, re.MULTILINE):
            yield name, " ".join(plain(text).split())


def _shown(value: Any) -> str:
    """Returns a value as it is typed: a text by itself needs no quotes."""
    return value if isinstance(value, str) else as_text(value)


def _rows(rows: list[tuple[str, str]]) -> str:
    width = min(44, max((len(left) for left, _ in rows), default=0))
    return "\n".join(f"  {left:<{width}}  {right}".rstrip() for left, right in rows)
