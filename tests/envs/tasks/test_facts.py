"""What listings show of a task without importing it, and what all tasks of a family share."""

import pytest

from envs.core.errors import MissingExtraError
from envs.robots import ROBOTS
from envs.tasks import TASKS


def installed():
    """Yields each task whose packages are installed, by its name."""
    for name in TASKS:
        try:
            task = TASKS.get(name)()
            _ = task.scenario  # LIBERO's tasks read their files only now
        except MissingExtraError:
            continue
        yield name, task


def test_every_task_names_source_paper_and_licence():
    for name in TASKS:
        info = TASKS.entry(name).info
        assert info["paper"].startswith("arXiv:") and info["licence"] and info["source"], name
        assert TASKS.entry(name).summary, name


@pytest.mark.slow
def test_every_robot_of_a_task_is_registered_under_its_name():
    alone = {task.robot.name for _, task in installed() if len(task.robots) == 1}
    assert alone <= {*ROBOTS, "franka_wiper"}  # its sponge is a tool of one task
    assert all(ROBOTS.get(name).name == name and ROBOTS.entry(name).summary for name in ROBOTS)


def test_tasks_of_a_family_share_robot_and_horizon():
    families = {}
    for name, task in installed():
        info = TASKS.entry(name).info
        if "family" in info:
            facts = (task.scenario.robots[0].name, task.max_episode_steps)
            families.setdefault(info["family"], set()).add(facts)
    assert families
    assert all(len(facts) == 1 for facts in families.values()), families
