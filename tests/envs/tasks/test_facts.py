"""What listings show of a task without importing it, and what all tasks of a family share."""

from dataclasses import dataclass

import pytest

from envs.core.errors import MissingExtraError
from envs.robots import ROBOTS
from envs.tasks import TASKS


@dataclass(frozen=True)
class Facts:
    """What one task says of itself."""

    only_robot: str | None
    first_robot: str
    horizon: int


@pytest.fixture(scope="module")
def facts() -> dict[str, Facts]:
    """Returns the facts of each task whose packages are installed, by its name."""
    found = {}
    for name in TASKS:
        try:
            task = TASKS.get(name)()
            robots = task.scenario.robots  # LIBERO's tasks read their files only now
        except MissingExtraError:
            continue
        only = task.robot.name if len(task.robots) == 1 else None
        found[name] = Facts(only, robots[0].name, task.max_episode_steps)
    return found


def test_every_task_names_source_paper_and_licence():
    for name in TASKS:
        info = TASKS.entry(name).info
        assert info["paper"].startswith("arXiv:") and info["licence"] and info["source"], name
        assert TASKS.entry(name).summary, name


@pytest.mark.slow
def test_every_robot_of_a_task_is_registered_under_its_name(facts):
    alone = {task.only_robot for task in facts.values()} - {None}
    assert alone <= {*ROBOTS, "franka_wiper"}  # its sponge is a tool of one task
    assert all(ROBOTS.get(name).name == name and ROBOTS.entry(name).summary for name in ROBOTS)


@pytest.mark.slow
def test_tasks_of_a_family_share_robot_and_horizon(facts):
    families = {}
    for name, task in facts.items():
        info = TASKS.entry(name).info
        if "family" in info:
            families.setdefault(info["family"], set()).add((task.first_robot, task.horizon))
    assert families
    assert all(len(shared) == 1 for shared in families.values()), families
