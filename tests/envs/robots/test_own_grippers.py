"""Grippers of the arms' makers: Rethink's, the xArm Gripper and the Jaco's three fingers."""

import numpy as np
import pytest

from envs.robots import ROBOTS
from envs.tasks.make import make_task
from tests.gripping_hand import GrippingHand
from tests.robot_files import needs_files_of

NEWTONS = {
    "sawyer_rethink": [20.0, 20.0],
    "xarm7_xarm_gripper": [46.0, 46.0],
    "jaco_three_finger": [7.2, 3.6, 3.6],
}
"""How much each fingertip presses a cube of 4 cm."""

OWN = list(NEWTONS)


@pytest.fixture(params=OWN)
def robot(request):
    needs_files_of(request.param)
    return ROBOTS.get(request.param)


def test_its_fingertips_are_as_far_apart_as_its_configuration_says(robot):
    hand = GrippingHand(robot)
    apart = []
    for half_gap in (robot.opening_m / 2, 0.0):
        hand.move(1.0, robot.finger_positions(half_gap))
        apart.append(hand.gap_m)
    # The Jaco's thumb and fingers miss each other sideways by 3 to 6 mm.
    assert apart == pytest.approx([robot.opening_m, robot.gripper_closed_m], abs=0.006)


def test_it_holds_a_cube_and_presses_it_with_what_its_motors_give(robot):
    hand = GrippingHand(robot, cube_m=0.04)
    hand.close(1.0)
    before = hand.cube_in_hand
    assert np.abs(before[:2]).max() < 0.002, "it takes the cube in its middle"
    assert hand.presses() == pytest.approx(NEWTONS[robot.name], rel=0.1)
    hand.model.opt.gravity[2] = -9.81
    hand.close(2.0)
    assert np.abs(hand.cube_in_hand - before).max() < 0.001
    hand.move(1.0, robot.finger_positions(robot.opening_m / 2))
    assert hand.cube_in_hand[2] > 0.05, "it lets go"


def test_hand_and_fingertips_are_where_those_of_the_franka_hand_are(robot):
    """Fingers open along the grip site's x; holding a cube, they reach 8 to 12 mm below it."""
    hand = GrippingHand(robot, cube_m=0.04)
    hand.close(1.0)
    site = hand.data.site(hand.layout.ee_site)
    pos, axes = site.xpos, site.xmat.reshape(3, 3)
    tips = (hand.data.geom_xpos[hand.tips] - pos) @ axes
    assert np.abs(tips[:, 0]).min() > 0.02 and np.sign(tips[:, 0]).sum() in (0, 1, -1)
    turns = hand.data.geom_xmat[hand.tips].reshape(-1, 3, 3)
    corners = np.abs(axes[:, 2] @ turns) * hand.model.geom_size[hand.tips]
    assert (tips[:, 2] + corners.sum(1)).max() == pytest.approx(0.01, abs=0.0025)


def test_bars_of_the_xarm_gripper_turn_together():
    needs_files_of("xarm7_xarm_gripper")
    robot = ROBOTS.get("xarm7_xarm_gripper")
    hand = GrippingHand(robot)
    leader = robot.fingers[0]
    for target in (0.3, 0.85, 0.0):
        hand.move(1.0, target)
        followers = [index for index, joint in enumerate(robot.joints) if joint.follows is not None]
        assert len(followers) == 5
        np.testing.assert_allclose(hand.joints[followers], hand.joints[leader], atol=1e-3)
        turns = hand.data.geom_xmat[hand.tips].reshape(-1, 3, 3)[:, :, 2]
        assert turns[0] @ turns[1] == pytest.approx(1.0, abs=1e-4)


def test_the_xarm_gripper_closes_at_its_makers_speed():
    needs_files_of("xarm7_xarm_gripper")
    robot = ROBOTS.get("xarm7_xarm_gripper")
    hand = GrippingHand(robot)
    hand.close(0.2)
    before = hand.joints[robot.fingers[0]]
    hand.close(0.1)
    assert (hand.joints[robot.fingers[0]] - before) / 0.1 == pytest.approx(2.0, rel=0.05)


def test_a_tip_of_the_jaco_bends_inwards_and_comes_back():
    robot = ROBOTS.get("jaco_three_finger")
    hand = GrippingHand(robot)
    tip = robot.joint_names.index("gripper/joint_thumb_distal")
    assert not robot.joints[tip].driven
    dof = int(hand.model.joint("jaco_three_finger/gripper/joint_thumb_distal").dofadr[0])
    hand.data.qfrc_applied[dof] = 0.05
    hand.move(1.0, hand.joints[list(robot.fingers)])
    assert hand.joints[tip] > 0.3
    hand.data.qfrc_applied[dof] = -0.05  # its stop
    hand.move(2.0, hand.joints[list(robot.fingers)])
    assert hand.joints[tip] == pytest.approx(0.0, abs=0.02)


def test_fingers_of_a_task_start_as_far_apart_as_the_tasks_own_robots():
    own, other = (make_task("PickChocolatePudding", robot=name).robot for name in ("", "sawyer_rethink"))
    gaps = []
    for robot in (own, other):
        shut, wide = np.array(robot.finger_limits).T
        at = np.array(robot.default_qpos)[list(robot.fingers)]
        share = np.mean((at - shut) / (wide - shut))
        gaps.append(robot.gripper_closed_m + share * (robot.opening_m - robot.gripper_closed_m))
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-6) and gaps[0] < 0.08
