"""What every registered robot promises: the contracts of ``roboverse check robot=…``."""

import pytest

from envs.robots import ROBOTS
from roboverse_learn.checks.contract import NotApplicableError
from roboverse_learn.checks.robots import ROBOT_CONTRACTS, CheckedRobot
from tests.robot_files import needs_files_of
from tests.sweeps import sweep

ALWAYS = [name for name in ROBOTS.names() if not name.endswith("_2f85")] + ["ur5e_2f85"]
"""Of the arms that carry the second gripper, one."""


@pytest.fixture(scope="module", params=sweep(ROBOTS.names(), ALWAYS))
def checked(request):
    needs_files_of(request.param)
    checked = CheckedRobot(request.param)
    yield checked
    checked.close()


@pytest.mark.slow
@pytest.mark.parametrize("contract", ROBOT_CONTRACTS, ids=lambda each: each.name)
def test_contract(checked, contract):
    try:
        contract.check(checked)
    except NotApplicableError as reason:
        pytest.skip(str(reason))
