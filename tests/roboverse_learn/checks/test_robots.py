"""Each contract of a robot finds the mistake that it is for, and says what to mend."""

import re
from dataclasses import replace

import pytest

from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from roboverse_learn.checks.contract import chosen, run
from roboverse_learn.checks.robots import ROBOT_CONTRACTS, CheckedRobot


def with_joint(index, **changes):
    joints = list(FRANKA.joints)
    joints[index] = replace(joints[index], **changes)
    return replace(FRANKA, joints=tuple(joints))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "contract", "message"),
    [
        (with_joint(1, default=9.0), "joints", r"default of 'joint2' is 9, outside of its range"),
        (
            with_joint(0, range=(1.0, -1.0)),
            "joints",
            r"range of 'joint1' is \(1.0, -1.0\): its low is",
        ),
        (
            with_joint(2, kp=0.0),
            "joints",
            "'joint3' is driven by position and needs kp and force_limit",
        ),
        (with_joint(1, name="joint1"), "joints", "The joint 'joint1' is named twice"),
        (
            with_joint(8, driven=False, follows=("gripper/finger_joint1", 0.5)),
            "joints",
            "default of 'gripper/finger_joint2' is 0.04, and what it follows puts it at 0.02",
        ),
        (with_joint(8, driven=False, follows=("thumb", 1.0)), "joints", "follows 'thumb', which is none of"),
        (replace(FRANKA, gripper_joints=("thumb",)), "joints", r"gripper_joints names \['thumb'\]"),
        (with_joint(3, name="elbow"), "scene", "elbow"),
        (replace(FRANKA, ee_site="nose"), "scene", "nose"),
        (
            with_joint(3, force_limit=0.01),
            "follows",
            "'joint4' had a target that differs by .* Check the order",
        ),
        (
            replace(with_joint(1, kp=1.0, kd=0.1), gravity_compensated=False),
            "rests",
            "'joint2' moved by .* while its targets were those of rest. Raise its kp",
        ),
    ],
)
def test_a_broken_robot_is_found(monkeypatch, robot, contract, message):
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    ROBOTS.add("mine", robot)
    checked = CheckedRobot("mine")
    try:
        finding = list(run(chosen(ROBOT_CONTRACTS, [contract]), checked))[-1]
    finally:
        checked.close()
    assert (finding.name, finding.result) == (contract, "failed")
    assert re.search(message, finding.detail), finding.detail
