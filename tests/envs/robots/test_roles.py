"""Joints by their role: arm and gripper, and how far a gripper is open, whatever its joints are."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from envs.scenario import JointCfg
from envs.state import EntityState
from envs.tasks.robot_columns import columns_of
from envs.tasks.tabletop import WRIST_CAMERA, arm_speed, finger_gap, grips_something, target_gap, wrist_camera


def hinge(name, *, driven=True):
    return JointCfg(name=name, kp=10.0, kd=0.5, force_limit=5.0, range=(0.0, 0.8), default=0.0, driven=driven)


HINGED = replace(
    FRANKA,
    name="hinged",
    joints=(*FRANKA.joints[:7], hinge("follower", driven=False), hinge("left"), hinge("right")),
    gripper_joints=("left", "right"),
    gripper_range=((0.8, 0.0), (0.8, 0.0)),  # closes upwards
    gripper_opening_m=0.085,
)
"""A gripper of hinges that close upwards, with a joint that only follows."""


def state(qpos, targets=None, speeds=None):
    robot = EntityState.at_rest(np.zeros(3), np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([qpos]))
    robot.joint_target = None if targets is None else torch.tensor([targets], dtype=torch.float64)
    if speeds is not None:
        robot.joint_vel = torch.tensor([speeds], dtype=torch.float64)
    return robot


def test_fingers_of_the_franka_are_metres_from_the_middle():
    assert FRANKA.arm == tuple(range(7)) and FRANKA.fingers == (7, 8)
    assert FRANKA.opening_m == 0.08
    for half_gap in (0.0, 0.04):
        assert FRANKA.finger_positions(half_gap).tolist() == [half_gap, half_gap]
    assert FRANKA.finger_positions(np.array([0.0, 0.03, 0.5])).shape == (3, 2)
    assert FRANKA.finger_positions(0.5).tolist() == [0.04, 0.04]


def test_hinges_that_close_upwards_are_mapped_by_their_range():
    assert HINGED.arm == tuple(range(7)) and HINGED.fingers == (8, 9)
    assert HINGED.finger_positions(0.0).tolist() == [0.8, 0.8]
    np.testing.assert_allclose(HINGED.finger_positions(0.0425), [0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(HINGED.finger_positions(0.02125), [0.4, 0.4])


def test_gaps_are_measured_in_metres_for_every_gripper():
    franka = state([0.0] * 7 + [0.01, 0.02], [0.0] * 9)
    assert finger_gap(franka).item() == 0.01 + 0.02
    assert target_gap(franka).item() == 0.0
    assert grips_something(franka, 0.02).item() and not grips_something(franka, 0.04).item()
    hinged = state([0.0] * 7 + [0.4, 0.4, 0.4], [0.0] * 7 + [0.8, 0.8])  # half open, targets closed
    assert finger_gap(hinged, HINGED).item() == pytest.approx(0.0425)
    assert target_gap(hinged, HINGED).item() == pytest.approx(0.0)
    assert grips_something(hinged, 0.03, HINGED).item()


def test_gaps_of_fingertips_that_do_not_meet_begin_where_they_close():
    blunt = replace(HINGED, name="blunt", gripper_closed_m=0.015)
    assert blunt.finger_positions(0.0075).tolist() == [0.8, 0.8]
    assert blunt.finger_positions(0.0).tolist() == [0.8, 0.8], "narrower than it closes"
    np.testing.assert_allclose(blunt.finger_positions(0.025), [0.4, 0.4])
    robot = state([0.0] * 7 + [0.4, 0.4, 0.4], [0.0] * 7 + [0.8, 0.8])
    assert finger_gap(robot, blunt).item() == pytest.approx(0.05)
    assert target_gap(robot, blunt).item() == pytest.approx(0.015)


def test_speed_of_an_arm_ignores_its_fingers():
    speeds = [0.1] * 6 + [5.0, 5.0]
    ur5e = ROBOTS.get("ur5e")
    assert arm_speed(state([0.0] * 8, speeds=speeds), ur5e).item() == pytest.approx(0.1)


def test_columns_of_neighbouring_joints_are_read_without_a_copy():
    assert columns_of(FRANKA).arm == slice(0, 7) and columns_of(FRANKA).finger_targets == (7, 8)
    assert columns_of(HINGED).fingers == (8, 9) and columns_of(HINGED).finger_targets == (7, 8)


def test_the_wrist_camera_is_on_the_robots_own_hand():
    assert wrist_camera(FRANKA) == WRIST_CAMERA
    assert wrist_camera(ROBOTS.get("iiwa")).mount == "iiwa/right_hand"
    message = "'cartpole' has no wrist camera: give its RobotCfg a camera_mount.*: franka, franka_2f85, iiwa"
    with pytest.raises(ConfigError, match=message):
        wrist_camera(ROBOTS.get("cartpole"))


def test_arms_that_are_named_in_place_of_a_robot_without_a_wrist_camera_have_one_and_six_joints():
    with pytest.raises(
        ConfigError, match="and have the six joints that a hand needs for any pose: "
    ) as raised:
        wrist_camera(ROBOTS.get("cartpole"))
    named = str(raised.value).rpartition(": ")[2].rstrip(".").split(", ")
    assert set(ROBOTS.names("arm")) - set(named) == {"so101"}, "five joints"
    for robot in map(ROBOTS.get, named):
        assert wrist_camera(robot).mount.startswith(robot.name) and len(robot.arm) >= 6
