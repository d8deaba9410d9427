"""Paths and inverse kinematics of the experts."""

import dataclasses

import mujoco
import numpy as np
import pytest

from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint, approach, correction_s, grasp_yaw, interpolate, minimum_jerk
from envs.robots.franka import FRANKA


def test_minimum_jerk_starts_and_ends_at_rest():
    share = minimum_jerk(100)
    assert share[-1] == 1.0
    assert share[49] == pytest.approx(0.5)
    assert (np.diff(share) > 0).all()
    assert share[0] < 1e-4 > 1 - share[-2]


def test_holds_wait_and_fingers_move_at_once():
    start = Waypoint(pos=np.zeros(3), yaw=0.0, gripper=0.04, duration_s=0.0)
    end = Waypoint(pos=np.ones(3), yaw=1.0, gripper=0.0, duration_s=0.5, hold_s=0.2)
    path = interpolate(start, [end], control_hz=20)
    assert len(path.pos) == 14
    np.testing.assert_array_equal(path.pos[9:], np.ones((5, 3)))
    assert (path.gripper == 0.0).all()


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.0, 0.0), (1.0, 1.0 - np.pi / 2), (-2.0, -2.0 + np.pi / 2)]
)
def test_a_cube_is_grasped_by_the_smallest_turn(angle, expected):
    assert grasp_yaw(angle) == pytest.approx(expected)


def test_three_approaches_in_ten_come_from_beside():
    way = Waypoint(pos=np.array([0.1, 0.2, 0.3]), yaw=0.5, gripper=0.04, duration_s=0.6, roll=0.1)
    rngs = (np.random.default_rng(seed) for seed in range(1000))
    ways = [approach(way, rng) for rng in rngs]
    missed = [first for first, *rest in ways if rest]
    assert 250 < len(missed) < 350
    assert all(len(path) < 3 for path in ways)
    for first, last in (path for path in ways if len(path) == 2):
        np.testing.assert_array_equal(last.pos, way.pos)
        np.testing.assert_array_equal(last.turn, way.turn)
        assert first.pos[2] == way.pos[2]
        assert last.duration_s == pytest.approx(0.1 + 2.0 * np.linalg.norm(first.pos - way.pos))
    assert all(path == [way] for path in ways if len(path) == 1)
    off = np.array([first.pos - way.pos for first in missed])[:, :2]
    np.testing.assert_allclose(off.std(axis=0), 0.05, atol=0.006)


def test_a_longer_way_back_takes_longer():
    assert correction_s(np.array([0.03, 0.04])) == pytest.approx(0.2)


def test_the_end_effector_follows_its_path_within_two_millimetres():
    follower = PathFollower(dataclasses.replace(FRANKA, pos=(-0.615, 0, 0)), control_hz=20)
    goal = np.array([0.05, -0.08, 0.1])
    targets = follower.joint_targets(
        np.array(FRANKA.default_qpos), [Waypoint(pos=goal, yaw=0.5, gripper=0.01, duration_s=1.0, hold_s=0.2)]
    )
    reached = follower._site_pose(targets[-1])
    np.testing.assert_allclose(reached.translation(), goal, atol=2e-3)
    assert reached.rotation().as_matrix()[2, 2] == pytest.approx(-1.0, abs=1e-3)
    assert targets[-1, 7:].tolist() == [0.01, 0.01]
    low, high = np.array([joint.range for joint in FRANKA.joints]).T
    assert (targets >= low - mujoco.mjMINVAL).all()
    assert (targets <= high + mujoco.mjMINVAL).all()
