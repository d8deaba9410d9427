"""What every registered robot promises: the contracts of ``roboverse check robot=…``."""

import pytest

from envs.core.errors import MissingExtraError
from envs.robots import ROBOTS
from roboverse_learn.checks.contract import NotApplicableError
from roboverse_learn.checks.robots import ROBOT_CONTRACTS, CheckedRobot
from tests.sweeps import sweep

ALWAYS = [name for name in ROBOTS.names() if not name.endswith("_2f85")] + ["ur5e_2f85"]
"""Of the arms that carry the second gripper, one."""


@pytest.fixture(scope="module", params=sweep(ROBOTS.names(), ALWAYS))
def checked(request):
    checked = CheckedRobot(request.param)
    try:
        assert checked.robot
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield checked
    checked.close()


@pytest.mark.slow
@pytest.mark.parametrize("contract", ROBOT_CONTRACTS, ids=lambda each: each.name)
def test_contract(checked, contract):
    try:
        contract.check(checked)
    except NotApplicableError as reason:
        pytest.skip(str(reason))
