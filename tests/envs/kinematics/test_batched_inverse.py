"""Batched inverse kinematics of paths: it reaches them, and equals the single follower."""

import logging

import numpy as np
import pytest
import torch

from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_euler, multiply

HZ = 20.0
REST = np.array(FRANKA.default_qpos)
COUNT = 5


@pytest.fixture(scope="module")
def batched():
    return BatchedPathFollower(FRANKA, HZ)


@pytest.fixture(scope="module")
def single():
    return PathFollower(FRANKA, HZ)


def ways(count=COUNT):
    """Down to the table, turned and tipped, and aside; every way of another length."""
    rng = np.random.default_rng(3)
    out = []
    for row in range(count):
        goal = np.array([0.55, 0.0, 0.1]) + rng.uniform(-0.15, 0.15, 3) * (1, 1, 0.5)
        turn = {
            "yaw": rng.uniform(-1.2, 1.2),
            "pitch": rng.uniform(-0.4, 0.4),
            "roll": rng.uniform(-0.4, 0.4),
        }
        out.append(
            [
                Waypoint(pos=goal, gripper=0.04, duration_s=0.8 + 0.1 * row, **turn),
                Waypoint(pos=goal + np.array([0, 0.1, 0.1]), gripper=0.0, duration_s=0.4, hold_s=0.2, **turn),
            ]
        )
    return out


def starts(count=COUNT):
    noise = np.random.default_rng(4).normal(0.0, 0.03, (count, 9)) * ([1] * 7 + [0] * 2)
    return REST + noise


def angle_deg(a, b):
    return np.degrees(2 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0, 1)))


@pytest.fixture(scope="module")
def by_kernel(batched):
    """Follows paths by what a GPU runs, on the CPU."""
    follower = BatchedPathFollower(FRANKA, HZ)
    follower.__dict__["_kernel"] = batched._ik.path_kernel()
    return follower


def test_it_is_where_the_single_follower_is(batched, single):
    """The bound of the design is 2 mm and 1°; the same objective gives a hundredth of it."""
    found = batched.joint_targets(starts(), ways())
    for row, (start, way) in enumerate(zip(starts(), ways(), strict=True)):
        expected = single.joint_targets(start, way)
        assert found.lengths[row] == len(expected)
        ours = found.targets[row, : len(expected)].numpy()
        np.testing.assert_allclose(ours[:, 7:], expected[:, 7:])
        pos, rot = batched.end_effectors(ours)
        expected_pos, expected_rot = batched.end_effectors(expected)
        assert np.linalg.norm(pos - expected_pos, axis=-1).max() < 2e-5
        assert angle_deg(rot, expected_rot).max() < 0.01
        np.testing.assert_allclose(ours, expected, atol=2e-3)


def test_it_arrives(batched):
    found = batched.joint_targets(starts(), ways())
    _, down = batched.end_effectors(REST[None])
    for row, way in enumerate(ways()):
        last = found.targets[row, found.lengths[row] - 1].numpy()
        pos, rot = batched.end_effectors(last[None])
        assert np.linalg.norm(pos[0] - way[-1].pos) < 1e-3
        assert angle_deg(rot[0], multiply(from_euler(way[-1].turn), down[0])) < 0.2


def test_a_path_does_not_depend_on_the_others(batched):
    """Beyond rounding, which the number of rows may change."""
    together = batched.joint_targets(starts(), ways())
    alone = batched.joint_targets(starts()[[3]], [ways()[3]])
    assert alone.targets.shape[1] == alone.lengths[0] == together.lengths[3]
    length = together.lengths[3]
    np.testing.assert_allclose(together.targets[3, :length], alone.targets[0], atol=1e-9)
    held, _ = batched.end_effectors(together.targets[3, length:].numpy())
    assert len(held)
    np.testing.assert_allclose(held, np.tile(ways()[3][-1].pos, (len(held), 1)), atol=1e-3)


def test_joints_stay_in_their_ranges_when_the_goal_is_out_of_reach(batched):
    far = [Waypoint(pos=np.array([1.5, 0.8, 0.2]), yaw=0.0, gripper=0.04, duration_s=1.5)]
    targets = batched.joint_targets(REST[None], [far]).targets[0].numpy()
    low, high = np.array([joint.range for joint in FRANKA.joints]).T
    assert (targets >= low).all()
    assert (targets <= high).all()
    assert np.isfinite(targets).all()


@pytest.mark.slow
def test_the_kernel_of_a_gpu_follows_the_same_paths(batched, by_kernel):
    ours, theirs = (way.joint_targets(starts(), ways()) for way in (by_kernel, batched))
    assert ours.lengths.tolist() == theirs.lengths.tolist()
    torch.testing.assert_close(ours.targets, theirs.targets, atol=1e-10, rtol=0)


@pytest.mark.slow
def test_the_kernel_of_a_gpu_keeps_joints_in_their_ranges(batched, by_kernel):
    """Rounding grows tenfold each step beyond: there the arm is stretched, and two ways are as good."""
    far = [Waypoint(pos=np.array([1.5, 0.8, 0.2]), yaw=0.0, gripper=0.04, duration_s=1.5)]
    ours, theirs = (way.joint_targets(REST[None], [far]).targets[0] for way in (by_kernel, batched))
    low, high = torch.tensor([joint.range for joint in FRANKA.joints], dtype=torch.float64).T
    assert ((ours == low) | (ours == high))[13:18, :7].any(1).all()
    torch.testing.assert_close(ours[:18], theirs[:18], atol=1e-9, rtol=0)
    assert ((ours >= low) & (ours <= high)).all()


def test_a_kernel_that_cannot_be_compiled_is_said_once(monkeypatch, caplog):
    follower = BatchedPathFollower(FRANKA, HZ)

    def refuse():
        raise RuntimeError("no compiler")

    monkeypatch.setattr(follower._ik, "path_kernel", refuse)
    monkeypatch.setattr(follower, "_device", torch.device("cuda"))
    with caplog.at_level(logging.WARNING):
        assert follower._kernel is None and follower._kernel is None
    assert caplog.messages == ["Paths are followed by torch, which is slower: no compiler"]
