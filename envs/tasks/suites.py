"""Suites: tasks by one name, for every command that takes ``suite=`` in place of ``task=``.

Other packages register suites through the entry-point group ``roboverse.suites``: the value is a sequence of
names of tasks, or a function without arguments that returns one; see ``docs/concepts/suites.md``.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

from envs.core.errors import ConfigError, RoboVerseError
from envs.core.registry import Registry
from envs.tasks import TASKS
from envs.tasks.calvin import catalogue as calvin
from envs.tasks.grasp_language import catalogue as grasp
from envs.tasks.libero import catalogue as libero
from envs.tasks.metaworld.catalogue import PREFIX as METAWORLD

type Names = Sequence[str] | Callable[[], Sequence[str]]

SUITES: "Registry[Names]" = Registry("suite", group="roboverse.suites")

PAPER = ("PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding", "NutAssembly")
"""The six tasks of RoboVerse's table of generalization (arXiv:2504.18904), as the leaderboard has them."""


def suite_tasks(name: str) -> tuple[str, ...]:
    """Returns the names of a suite's tasks, in the suite's order; nothing of them is imported.

    Raises:
        UnknownNameError: There is no such suite.
        ConfigError: It is empty, names a task twice, is no list of names, or cannot be made.
    """
    target = SUITES.get(name)
    try:
        names = target() if callable(target) else target
    except RoboVerseError:  # it says by itself what is wrong
        raise
    except Exception as error:
        raise ConfigError(f"The suite '{name}' cannot be made: {type(error).__name__}: {error}") from error
    is_list = isinstance(names, Iterable) and not isinstance(names, str)
    if not is_list or not all(isinstance(each, str) for each in names):
        raise ConfigError(f"The suite '{name}' must be a list of names of tasks, given {names!r}.")
    if not names:
        raise ConfigError(f"The suite '{name}' has no tasks.")
    twice = next((each for each in names if list(names).count(each) > 1), None)
    if twice is not None:
        raise ConfigError(f"The suite '{name}' names the task '{twice}' twice. Name each once.")
    return tuple(names)


def _from_source(source: str) -> tuple[str, ...]:
    """Returns the tasks of this package whose source has that name, sorted."""
    entries = map(TASKS.entry, TASKS)
    return tuple(each.name for each in entries if each.info.get("source") == source and not each.distribution)


def _starting_with(prefix: str) -> tuple[str, ...]:
    return tuple(name for name in TASKS if name.startswith(prefix))


def _of_libero(suite: str) -> tuple[str, ...]:
    """Returns the tasks of one of LIBERO's suites in LIBERO's own order; empty is all of them."""
    return tuple(entry.name for entry in libero.entries().values() if suite in ("", entry.suite))


def _of_libero_10_with_expert() -> tuple[str, ...]:
    """Returns the tasks of LIBERO-10 but the one in which a door is opened, which the expert cannot."""
    return tuple(name for name in _of_libero("10") if not name.endswith("in_the_microwave_and_close_it"))


def _of_libero_pro(folder: str) -> tuple[str, ...]:
    """Returns the tasks of one suite of LIBERO-PRO, such as ``goal_swap``, in LIBERO's own order."""
    return tuple(entry.name for entry in libero.pro_entries().values() if entry.folder == folder)


def _of_calvin(scenes: str) -> tuple[str, ...]:
    """Returns CALVIN's 34 tasks in each of some scenes, in CALVIN's order."""
    return tuple(entry.name for entry in calvin.entries().values() if entry.scene in scenes)


def _of_metaworld() -> tuple[str, ...]:
    return tuple(sorted({*_from_source("Meta-World 3"), *_starting_with(METAWORLD)}))


SUITES.add("paper", PAPER, summary="the six tasks of RoboVerse's table")
for _suite, _words in {
    "spatial": "one bowl, its place changes",
    "object": "one of ten groceries into a basket",
    "goal": "one scene, ten goals",
    "10": "ten long tasks",
    "90": "ninety short tasks",
}.items():
    SUITES.add(f"libero_{_suite}", partial(_of_libero, _suite), summary=f"LIBERO: {_words}")
SUITES.add(
    "libero_10_expert",
    _of_libero_10_with_expert,
    summary="LIBERO: the nine long tasks that the expert solves",
)
for _set, (_start, _words) in {
    "few": ("few/", "five groceries"),
    "many": ("many/", "ten groceries"),
    "unseen": ("unseen/", "seven groceries that the other sets lack"),
    "colours": ("colours_", "three scenes of ten groceries, most in another colour"),
}.items():
    SUITES.add(
        f"grasp/{_set}",
        partial(_starting_with, f"{grasp.PREFIX}{_start}"),
        summary=f"grasp by language: {_words}",
    )
SUITES.add("libero", partial(_of_libero, ""), summary="LIBERO's five suites together")
for _suite in libero.PRO_SUITES:
    for _variant, _words in libero.VARIANTS.items():
        _folder = f"{_suite}_{_variant}"
        SUITES.add(f"libero_pro/{_folder}", partial(_of_libero_pro, _folder), summary=f"LIBERO-PRO: {_words}")
SUITES.add("calvin", partial(_of_calvin, "D"), summary="CALVIN's 34 tasks in its test scene, D")
SUITES.add(
    "calvin_abc", partial(_of_calvin, "ABC"), summary="CALVIN's 34 tasks in its training scenes, A to C"
)
SUITES.add("maniskill", partial(_from_source, "ManiSkill 3"), summary="table-top tasks of ManiSkill 3")
SUITES.add("robosuite", partial(_from_source, "robosuite 1.5"), summary="single-arm tasks of robosuite")
SUITES.add("metaworld", _of_metaworld, summary="Meta-World's tasks")
SUITES.add("humanoid", partial(_starting_with, "humanoid/"), summary="HumanoidBench's locomotion; no expert")
