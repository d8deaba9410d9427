"""What every registered robot promises: the contracts of ``roboverse check robot=…``."""

import pytest

from envs.core.errors import MissingExtraError
from envs.robots import ROBOTS
from roboverse_learn.checks.contract import NotApplicableError
from roboverse_learn.checks.robots import ROBOT_CONTRACTS, RobotSubject


@pytest.fixture(scope="module", params=ROBOTS.names())
def subject(request):
    subject = RobotSubject(request.param)
    try:
        assert subject.robot
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield subject
    subject.close()


@pytest.mark.slow
@pytest.mark.parametrize("contract", ROBOT_CONTRACTS, ids=lambda each: each.name)
def test_contract(subject, contract):
    try:
        contract.check(subject)
    except NotApplicableError as reason:
        pytest.skip(str(reason))
