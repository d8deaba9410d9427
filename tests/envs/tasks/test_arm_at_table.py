"""What tasks of an arm at a table share: grasps, and where the hand is commanded to be."""

import numpy as np
import pytest
import torch

from envs.kinematics.inverse import PathFollower
from envs.rotations import from_euler, from_yaw, multiply
from envs.state import EntityState
from envs.tasks.arm_at_table import EASY_REACH_M, tip_to_reach, way
from envs.tasks.maniskill.push_and_pull import PushCube
from envs.tasks.robosuite.cubes import Lift
from envs.tasks.tabletop import hand_pitch, hand_yaw, is_held, point_on
from tests.envs.tasks.table_states import grip, starts, vector

DOWN = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])


@pytest.mark.parametrize(
    ("width", "target", "away", "held"),
    [
        (0.04, 0.0, 0.0, True),
        (0.04, 0.0194, 0.0, True),  # 1.2 mm closer than they are
        (0.04, 0.0196, 0.0, False),
        (0.029, 0.0, 0.0, False),  # below three quarters of its width
        (0.04, 0.0, 0.031, False),
    ],
)
def test_a_thing_is_held_by_fingers_that_it_keeps_apart(width, target, away, held):
    state = starts(PushCube())
    grip(state, (0.1, 0.0, 0.02), width)
    robot = state.robots["franka"]
    robot.joint_target[:, 7:] = target
    assert is_held(robot, vector(0.1 + away, 0.0, 0.02), 0.03, 0.04).tolist() == [held]
    assert is_held(state.arrays().robots["franka"], vector(0.1 + away, 0.0, 0.02).numpy(), 0.03, 0.04) == held


@pytest.mark.parametrize("yaw", [-1.2, 0.0, 0.7])
@pytest.mark.parametrize("pitch", [-0.6, 0.0, 0.4])
def test_turn_and_pitch_of_a_hand_are_those_of_its_waypoint(yaw, pitch):
    state = starts(PushCube())
    robot = state.robots["franka"]
    robot.ee_rot = torch.from_numpy(multiply(from_euler(np.array([[yaw, pitch, 0.0]])), DOWN))
    assert hand_yaw(robot) == pytest.approx(yaw)
    assert hand_pitch(robot) == pytest.approx(pitch)


@pytest.mark.parametrize("task", [PushCube(), Lift()])
def test_the_commanded_pose_is_the_last_waypoint(task):
    robot = task.scenario.robots[0]
    end = way(np.array([0.05, 0.1, 0.2]), 0.5, 0.04, 1.0, pitch=task.down_pitch_rad - 0.2)
    targets = PathFollower(robot, 20.0).joint_targets(np.array(robot.default_qpos), [end])
    state = starts(task)
    state.robots["franka"].joint_target = torch.from_numpy(targets[-1:])
    commanded = task.commanded(state)
    np.testing.assert_allclose(commanded.pos, end.pos, atol=1e-3)
    np.testing.assert_allclose(commanded.turn, end.turn, atol=5e-3)


def test_a_far_place_tips_the_hand():
    robot = PushCube().scenario.robots[0]
    near, far, beyond = (
        tip_to_reach(np.array([robot.pos[0] + reach, 0.0, 0.0]), robot)
        for reach in (EASY_REACH_M, EASY_REACH_M + 0.1, 2.0)
    )
    assert (near, far, beyond) == pytest.approx((0.0, -0.4, -0.6))


def test_a_low_hand_rises_and_a_high_one_does_not():
    task = Lift()
    state = starts(task)
    assert task.rise(state, 0.2) == []
    state.robots["franka"].ee_pos = vector(0.1, 0.2, 0.05)
    (up,) = task.rise(state, 0.2)
    np.testing.assert_allclose(up.pos, [0.1, 0.2, 0.21])
    assert up.pitch == task.down_pitch_rad and up.gripper == 0.04


def test_a_point_of_an_object_moves_and_turns_with_it():
    entity = EntityState.at_rest(
        np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), from_yaw(np.array([np.pi / 2, 0.0]))
    )
    found = point_on(entity, (0.1, 0.2, 0.3)).numpy()
    np.testing.assert_allclose(found, [[0.8, 2.1, 3.3], [0.1, 0.2, 0.3]], atol=1e-12)
