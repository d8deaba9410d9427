"""PickCube's numbers, by hand."""

import numpy as np
import pytest
import torch

from envs.kinematics.waypoints import interpolate
from envs.tasks.pick_cube import LARGEST_MISS_M, MARKER_MISSES_M, PickCube


def states(count=1, variant="goal"):
    return PickCube(variant=variant).initial_state([np.random.default_rng(i) for i in range(count)])


def test_initial_states_fill_maniskills_ranges():
    state = states(2000)
    cube, goal = state.objects["cube"].pos, state.objects["goal"].pos
    for values, low, high in (
        (cube[:, 0], -0.1, 0.1),
        (cube[:, 1], -0.1, 0.1),
        (goal[:, 0], -0.1, 0.1),
        (goal[:, 2], 0.02, 0.32),
    ):
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high >= values.max() > high - 0.01 * (high - low)
    assert (cube[:, 2] == 0.02).all()
    arm = state.robots["franka"].joint_pos[:, :7] - torch.tensor(
        PickCube().scenario.robots[0].default_qpos[:7]
    )
    assert arm.std() == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize(
    ("distance", "speed", "solved"), [(0.0249, 0.19, True), (0.0251, 0.0, False), (0.0, 0.21, False)]
)
def test_success_is_near_and_still(distance, speed, solved):
    state = states()
    state.objects["cube"].pos[:] = state.objects["goal"].pos + torch.tensor([0.0, distance, 0.0])
    state.robots["franka"].joint_vel[:, 3] = -speed
    assert PickCube().success(state).tolist() == [solved]


def test_the_papers_variant_lifts_by_ten_centimetres():
    state = states(variant="lift")
    assert "goal" not in state.objects
    for height, solved in ((0.1199, False), (0.1201, True)):
        state.objects["cube"].pos[:, 2] = height
        assert PickCube(variant="lift").success(state).tolist() == [solved]


def test_reward_by_hand():
    """Far from the goal, not grasped, still: 0.2 (1 - tanh(5 · reach))."""
    state = states()
    robot, cube = state.robots["franka"], state.objects["cube"]
    robot.ee_pos = cube.pos + torch.tensor([[0.0, 0.0, 0.1]])
    robot.joint_target = robot.joint_pos.clone()
    state.objects["goal"].pos[:] = cube.pos + torch.tensor([0.0, 0.0, 0.3])
    expected = 0.2 * (1 - np.tanh(0.5))
    assert PickCube().reward(state).item() == pytest.approx(expected)
    # The cube keeps closed fingers apart: the grasp's reward is 1, plus that of nearness to the goal.
    robot.ee_pos = cube.pos.clone()
    robot.joint_pos[:, 7:] = 0.019
    robot.joint_target[:, 7:] = 0.0
    expected = 0.2 * (1 + 1 + (1 - np.tanh(1.5)))
    assert PickCube().reward(state).item() == pytest.approx(expected)


def test_the_expert_comes_back_to_the_marker_from_where_a_policy_misses_it():
    task, passed = PickCube(), []
    for i in range(200):
        state = task.initial_state([np.random.default_rng(i)])
        *_, first, second, last = task.expert(state, np.random.default_rng(1000 + i))
        goal = state.objects["goal"].pos[0].numpy()
        np.testing.assert_allclose(last.pos, goal)
        passed.append([first.pos - goal, second.pos - goal])
        way = interpolate(first, [second, last], control_hz=20)
        assert np.linalg.norm(np.diff(way.pos, axis=0), axis=1).max() < 0.05, "slower than 1 m/s"
        assert min(first.pos[2], second.pos[2]) >= 0.02, "not into the table"
    misses = np.array(passed)
    assert np.abs(misses).max() <= LARGEST_MISS_M + 1e-9
    assert (misses[:, 0, 2] > 0.04).sum() > 20 < (misses[:, 0, 2] < -0.04).sum()
    level = misses[..., :2].std(axis=(0, 2))
    assert level == pytest.approx(np.array(MARKER_MISSES_M), rel=0.2)
