"""What the registry says of tasks, which listings show without importing them, is what the tasks say."""

import pytest

from envs.core.errors import MissingExtraError
from envs.robots import ROBOTS
from envs.tasks import TASKS

FACTS = {"source", "paper", "licence", "robot", "horizon"}


@pytest.mark.parametrize("name", TASKS.names())
def test_the_registry_says_what_the_task_says(name):
    info = TASKS.entry(name).info
    assert set(info) >= FACTS
    try:
        task = TASKS.get(name)()
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert info["horizon"] == str(task.max_episode_steps)
    assert info["robot"] == task.scenario.robots[0].name


def test_every_robot_of_a_task_is_registered_under_its_name():
    assert {TASKS.entry(name).info["robot"] for name in TASKS} == set(ROBOTS)
    assert all(ROBOTS.get(name).name == name and ROBOTS.entry(name).summary for name in ROBOTS)


@pytest.mark.parametrize("name", TASKS.names())
def test_where_a_task_comes_from_is_said_in_full(name):
    info = TASKS.entry(name).info
    assert info["paper"].startswith("arXiv:") and info["licence"] and info["source"]


def test_a_family_shares_source_robot_and_horizon():
    shared = {}
    for entry in map(TASKS.entry, TASKS):
        if "family" in entry.info:
            shared.setdefault(entry.info["family"], []).append(dict(entry.info))
    for infos in shared.values():
        assert all(info == infos[0] for info in infos)
