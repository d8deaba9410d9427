"""Skips tests of a robot whose files are not on this machine."""

import pytest

from envs.core.assets import resolve
from envs.core.errors import MissingAssetError, MissingExtraError
from envs.mjcf.robots import robot_spec
from envs.robots import ROBOTS
from envs.tasks import TASKS


def needs_files_of(name: str) -> None:
    """Skips a test where a package or an asset folder of a robot is absent, and says how to get it."""
    try:
        robot_spec(ROBOTS.get(name))
    except (MissingAssetError, MissingExtraError) as error:
        pytest.skip(str(error))


def needs_files_of_task(name: str) -> None:
    """Skips a test where what a task's robots are made of is absent, and says how to get it."""
    try:
        for robot in TASKS.get(name)().robots:
            resolve(robot.mjcf)
    except (MissingAssetError, MissingExtraError) as error:
        pytest.skip(str(error))
