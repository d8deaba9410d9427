"""Paths of poses are followed, by the same objective as waypoints, inside the joints' limits."""

import numpy as np
import pytest

from envs.kinematics.inverse import PathFollower
from envs.kinematics.pose_follower import PoseFollower
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_yaw, multiply

REST = np.array(FRANKA.default_qpos)


@pytest.fixture(scope="module")
def follower():
    return PoseFollower(FRANKA)


def test_path_is_followed_within_a_millimetre(follower):
    pos, rot = follower.pose(REST)
    share = np.linspace(0.0, 1.0, 40)[:, None]
    path = pos + share * np.array([0.1, 0.15, -0.2])
    turns = multiply(from_yaw(share[:, 0]), rot)
    found = follower.follow(REST, path, turns)
    assert found.errors_m.max() < 1e-3 and found.errors_rad.max() < 5e-3
    for step in (0, 20, 39):
        there, turned = follower.pose(found.targets[step])
        np.testing.assert_allclose(there, path[step], atol=1e-3)
        assert abs(turned @ turns[step]) == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_array_equal(found.targets[:, 7:], np.tile(REST[7:], (40, 1)))


def test_waypoints_are_followed_alike(follower):
    """A QP and a Gauss-Newton step have the same objective: postures differ by less than 2 degrees."""
    pos, rot = follower.pose(REST)
    goal = Waypoint(pos=pos + np.array([0.05, 0.1, -0.15]), yaw=0.4, gripper=0.04, duration_s=2.0)
    expected = PathFollower(FRANKA, 20.0).joint_targets(REST, [goal])
    poses = [follower.pose(row) for row in expected]
    found = follower.follow(REST, *(np.array(part) for part in zip(*poses, strict=True)))
    assert np.abs(found.targets - expected)[:, :7].max() < 0.035
    assert rot.shape == (4,)


def test_limits_hold_where_a_path_leaves_the_reach(follower):
    pos, rot = follower.pose(REST)
    path = pos + np.linspace(0.0, 1.0, 40)[:, None] * np.array([1.0, 0.0, 0.0])
    turns = multiply(from_yaw(np.linspace(0.0, 4.0, 40)), rot)
    found = follower.follow(REST, path, turns)
    low, high = np.array([joint.range for joint in FRANKA.joints]).T
    assert (found.targets >= low - 1e-9).all() and (found.targets <= high + 1e-9).all()
    assert found.errors_m[0] < 1e-3 and found.errors_m[-1] > 0.1
