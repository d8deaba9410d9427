"""What every registered task promises, on its default simulator: the contracts of ``roboverse check``.

The 45 tasks tagged ``adapted`` share one class, and so do LIBERO's 130 and CALVIN's:
``test_adapted_tasks.py``, ``test_libero_tasks.py`` and ``test_calvin_tasks.py`` look at them more briefly.
Tasks tagged ``same_scene`` differ from another one in what they name alone.
"""

import pytest

from envs.core.errors import MissingExtraError
from envs.spec import EnvSpec
from envs.tasks import TASKS
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import NotApplicableError
from roboverse_learn.checks.tasks import TASK_CONTRACTS
from tests.robot_files import needs_files_of_task
from tests.sweeps import sweep

NUM_ENVS = 3

NAMES = [name for name in TASKS if not {"adapted", "calvin", "libero", "same_scene"} & TASKS.entry(name).tags]
REPRESENTATIVE = {
    *("PickCube", "StackCube", "CloseBox", "DrawerOpen"),
    *("control/ant", "control/cartpole", "control/franka_reach", "humanoid/walk", "humanoid/maze"),
}
"""A free object, two of them, a joint of ours and one of Meta-World; every robot that acts by itself."""

QUICK = {"options", "words", "scenario", "initial_states"}
"""Contracts that need no simulator."""


@pytest.fixture(scope="module", params=sweep(NAMES, REPRESENTATIVE))
def checked(request):
    """The expert of each of our tasks solves all of its first starts."""
    needs_files_of_task(request.param)
    spec = EnvSpec(task=request.param, image_size=32)
    checked = CheckedTask(spec, num_envs=NUM_ENVS, episodes=2 * NUM_ENVS, required=1.0)
    try:
        assert checked.task_class
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield checked
    checked.close()


@pytest.mark.parametrize(
    "contract",
    [pytest.param(each, id=each.name, marks=() if each.name in QUICK else pytest.mark.slow)
     for each in TASK_CONTRACTS],
)  # fmt: skip
def test_contract(checked, contract):
    try:
        contract.check(checked)
    except NotApplicableError as reason:
        pytest.skip(str(reason))


@pytest.mark.slow
def test_much_of_what_is_observed_varies_between_starts(checked):
    """Heights, orientations and velocities may start out equal; positions may not.

    Meta-World starts with the hand in one place, and fills its observation up with zeros.
    """
    moving = checked.observed_starts(30).std(axis=0) > 1e-6
    assert moving.any() if "metaworld" in TASKS.entry(checked.spec.task).tags else moving.mean() > 0.4
