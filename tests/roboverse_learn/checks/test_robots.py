"""Each contract of a robot finds the mistake that it is for, and says what to mend."""

import re
from dataclasses import replace
from typing import Any

import mujoco
import pytest
import torch

from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from envs.simulators import HANDLERS
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import State
from roboverse_learn.checks.contract import BrokenContractError, chosen, run
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


def forget_speeds(handler, entity):
    """A simulator that leaves the speeds of passive joints as they were."""
    driven = torch.tensor([joint.driven for joint in handler.scenario.robots[0].joints])
    now = handler.get_states().robots[handler.scenario.robots[0].name]
    return replace(entity, joint_vel=torch.where(driven, entity.joint_vel, now.joint_vel))


def forget_targets(handler, entity):
    """A simulator that leaves the targets as they were."""
    now = handler.get_states().robots[handler.scenario.robots[0].name]
    return replace(entity, joint_target=now.joint_target.clone())


def forget_the_base(handler, entity):
    """A simulator that leaves a free base at its speed."""
    now = handler.get_states().robots[handler.scenario.robots[0].name]
    return replace(entity, lin_vel=now.lin_vel.clone())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "forget", "message"),
    [
        ("ur5e_2f85", forget_speeds, "joint_vel of '.*' is another after 0 steps from the same state"),
        ("ur5e_2f85", forget_targets, "joint_pos of '.*' is another after 1 step from the same state"),
        ("ant", forget_the_base, "lin_vel of 'x' is another after 0 steps from the same state"),
    ],
)
def test_a_simulator_that_restores_a_part_of_the_state_is_found(monkeypatch, robot, forget, message):
    class Forgetful(MujocoHandler):
        def set_states(self, states, env_ids=None):
            robots = {name: forget(self, entity) for name, entity in states.robots.items()}
            super().set_states(State(robots, states.objects), env_ids)

    monkeypatch.setattr(HANDLERS, "_entries", dict(HANDLERS._entries))
    HANDLERS.add("forgetful", Forgetful)
    checked = CheckedRobot(robot, "forgetful")
    try:
        finding = list(run(chosen(ROBOT_CONTRACTS, ["resets"]), checked))[-1]
    finally:
        checked.close()
    assert (finding.name, finding.result) == ("resets", "failed"), finding.detail
    assert re.search(message, finding.detail), finding.detail


def test_activations_which_no_state_holds_are_refused():
    checked = CheckedRobot("cartpole")
    try:
        handler: Any = checked.handler
        handler.model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><joint name='hinge'/><geom size='.1'/></body></worldbody>"
            "<actuator><general joint='hinge' dyntype='filter' dynprm='0.05'/></actuator></mujoco>"
        )
        with pytest.raises(BrokenContractError, match="have activations, which no state holds"):
            next(each for each in ROBOT_CONTRACTS if each.name == "resets").check(checked)
    finally:
        checked.close()
