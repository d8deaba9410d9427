"""The Robotiq 2F-85 opens, closes and holds as its data sheet says, and any arm takes it."""

from dataclasses import replace

import numpy as np
import pytest

from envs.core.errors import SimulatorError
from envs.robots import ARMS, GRIPPERS, ROBOTS, with_grippers
from envs.robots.franka import FRANKA
from envs.robots.panda_hand import PANDA_HAND
from envs.robots.robotiq_2f85 import ROBOTIQ_2F85
from envs.scenario import ScenarioCfg
from envs.simulators import HANDLERS
from envs.tasks.make import make_task
from envs.tasks.tabletop import CONTROL_20_HZ
from tests.gripping_hand import GrippingHand

ROBOT = ROBOTS.get("ur5e_2f85")
LEADER = ROBOT.fingers[0]


def test_it_opens_to_85_mm_and_closes_at_150_mm_per_second():
    hand = GrippingHand(ROBOT)
    assert hand.gap_m == pytest.approx(ROBOT.opening_m, abs=0.001)
    hand.close(0.2)
    before = hand.gap_m
    hand.close(0.1)
    assert (before - hand.gap_m) / 0.1 == pytest.approx(0.150, rel=0.05)
    hand.close(1.0)
    assert 0.0 <= hand.gap_m < 0.0015
    assert ROBOT.finger_positions(0.0).tolist() == [0.8] and ROBOT.finger_positions(0.5).tolist() == [0.0]


def test_the_loops_stay_closed_and_the_fingertips_parallel():
    hand = GrippingHand(ROBOT)
    for target in (0.3, 0.8, 0.0):
        hand.move(1.0, target)
        for index, joint in enumerate(ROBOT.joints):
            if joint.follows is not None:
                assert hand.joints[index] == pytest.approx(joint.follows[1] * hand.joints[LEADER], abs=1e-3)
        turns = [hand.data.geom_xmat[tip].reshape(3, 3)[:, 2] for tip in hand.tips]
        assert turns[0] @ turns[1] == pytest.approx(1.0, abs=1e-4)


def test_it_presses_a_cube_with_what_the_motor_gives():
    hand = GrippingHand(ROBOT, cube_m=0.04)
    hand.close(1.0)
    assert hand.gap_m == pytest.approx(0.04, abs=0.001)
    presses = hand.presses()
    assert presses == pytest.approx([46.0, 46.0], rel=0.1)
    assert 20.0 <= min(presses) <= max(presses) <= 235.0, "the data sheet's range"
    for index, joint in enumerate(ROBOT.joints):  # the grip does not bend the ties
        if joint.follows is not None:
            assert hand.joints[index] == pytest.approx(joint.follows[1] * hand.joints[LEADER], abs=0.005)


def test_every_arm_takes_every_gripper():
    for arm in ARMS:
        for gripper in GRIPPERS:
            robot = getattr(with_grippers, f"{arm}_{gripper}".upper())
            assert robot.name == f"{arm}_{gripper}" and robot.arm == ROBOTS.get(ARMS[arm].name).arm
            assert robot.gripper_joints == GRIPPERS.get(gripper).gripper_joints
    with pytest.raises(AttributeError, match="no attribute 'UR5E_TONGS'"):
        _ = with_grippers.UR5E_TONGS


def test_an_arm_is_listed_with_the_2f85_and_with_the_gripper_of_its_maker():
    listed = {(arm, gripper) for arm in ARMS for gripper in GRIPPERS if f"{arm}_{gripper}" in ROBOTS}
    own = {("sawyer", "rethink"), ("jaco", "three_finger"), ("xarm7", "xarm_gripper")}
    assert listed == {(arm, "2f85") for arm in ARMS} | own
    for arm, gripper in listed:
        assert ROBOTS.get(f"{arm}_{gripper}").name == f"{arm}_{gripper}"
        assert GRIPPERS.entry(gripper).summary in ROBOTS.entry(f"{arm}_{gripper}").summary


def test_a_gripper_is_exchanged_for_another_and_back():
    changed = FRANKA.with_gripper(ROBOTIQ_2F85, "franka_2f85")
    assert changed.opening_m == 0.085 and changed.finger_limits == ((0.8, 0.0),)
    assert changed.with_gripper(PANDA_HAND, "franka") == FRANKA


def test_joints_that_follow_are_where_they_must_be_at_rest():
    half = ROBOT.with_home([*ROBOT.default_qpos[:LEADER], 0.4, *[0.0] * 5])
    assert half.default_qpos[LEADER:] == (0.4, -0.4, 0.4, 0.4, -0.4, 0.4)
    task = make_task("PickChocolatePudding", robot="ur5e_2f85")  # begins with fingers that are half open
    fingers = np.array(task.robot.default_qpos[LEADER:])
    assert 0.1 < fingers[0] < 0.7
    np.testing.assert_allclose(fingers, fingers[0] * np.array([1, -1, 1, 1, -1, 1]))


@pytest.mark.parametrize("simulator", ["pybullet", "sapien", "newton"])
def test_a_simulator_without_ties_refuses_it(simulator):
    pytest.importorskip(simulator)
    scene = ScenarioCfg(robots=(replace(ROBOT, name="hand"),), table=None, physics=CONTROL_20_HZ)
    handler = HANDLERS.get(simulator)(scene, 1)
    with pytest.raises(SimulatorError, match=r"has no equality constraint such as.*Take simulator=mujoco"):
        handler.launch()
