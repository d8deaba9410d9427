"""Suites: which tasks each name stands for."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.core.registry import Registry
from envs.experts.counts import read_rows
from envs.tasks import TASKS, suites
from envs.tasks.libero.catalogue import entries
from envs.tasks.suites import SUITES, suite_tasks

OUR_TASKS = ("PickCube", "StackCube")
"""What a package's entry point may name."""


@pytest.mark.parametrize("suite", SUITES.names())
def test_every_suite_names_registered_tasks_once(suite):
    names = suite_tasks(suite)
    assert names and set(names) <= set(TASKS) and len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("suite", "number"),
    [
        ("paper", 6),
        ("libero_spatial", 10),
        ("libero_object", 10),
        ("libero_goal", 10),
        ("libero_10", 10),
        ("libero_10_expert", 9),
        ("libero_90", 90),
        ("libero", 130),
        ("maniskill", 15),
        ("robosuite", 17),
        ("metaworld", 50),
    ],
)
def test_a_suite_has_all_of_its_source(suite, number):
    assert len(suite_tasks(suite)) == number


def test_tasks_of_liberos_suites_are_in_its_own_order():
    """``libero_suite_task_map.py``: task 0 and task 9 of ``libero_10``."""
    names = suite_tasks("libero_10")
    assert names[0].endswith("scene2_put_both_the_alphabet_soup_and_the_tomato_sauce_in_the_basket")
    assert names[9].endswith("kitchen_scene6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it")
    assert {*suite_tasks("libero")} == {*entries()}


def test_what_the_expert_solves_of_libero_10_is_what_was_counted():
    counts = read_rows(Path(__file__).parents[3] / "results/tasks.json")
    solved = [name for name in suite_tasks("libero_10") if counts[name]["expert"] > 0]
    assert list(suite_tasks("libero_10_expert")) == solved


def test_unknown_suite_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match=r"'libero_spacial'. Did you mean 'libero_spatial'"):
        suite_tasks("libero_spacial")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ((), "has no tasks"),
        (("PickCube", "PickCube"), "names the task 'PickCube' twice"),
        ("PickCube", "must be a list of names"),
        ((3,), "must be a list of names"),
        (None, "must be a list of names"),
    ],
)
def test_a_suite_that_is_none_is_refused(monkeypatch, names, said):
    monkeypatch.setattr(suites, "SUITES", own := Registry("suite"))
    own.add("odd", lambda: names)
    with pytest.raises(ConfigError, match=said):
        suite_tasks("odd")


def test_a_suite_whose_function_fails_is_named_with_the_error(monkeypatch):
    monkeypatch.setattr(suites, "SUITES", own := Registry("suite"))
    own.add("odd", lambda: {}["gone"])
    with pytest.raises(ConfigError, match=r"The suite 'odd' cannot be made: KeyError: 'gone'"):
        suite_tasks("odd")


def test_other_packages_register_suites_by_entry_points(monkeypatch):
    point = importlib.metadata.EntryPoint("theirs", f"{__name__}:OUR_TASKS", "roboverse.suites")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point])
    monkeypatch.setattr(suites, "SUITES", Registry("suite", group="roboverse.suites"))
    monkeypatch.setitem(sys.modules, __name__, sys.modules[__name__])
    assert suite_tasks("theirs") == OUR_TASKS


def test_listing_suites_imports_no_task():
    program = (
        "import sys; from envs.tasks.suites import SUITES, suite_tasks; [suite_tasks(s) for s in SUITES]; "
        "sys.exit(any(m in sys.modules for m in ('mujoco', 'torch', 'envs.tasks.pick_cube')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
