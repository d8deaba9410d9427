"""PushCube's and PullCube's numbers, by hand."""

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.tasks.maniskill.push_and_pull import PullCube, PushCube
from tests.envs.tasks.table_states import assert_fills, put, starts, vector

PAIR = pytest.mark.parametrize(("task", "side"), [(PushCube(), 1.0), (PullCube(), -1.0)])


@PAIR
def test_starts_fill_the_square_and_the_target_is_20_cm_away(task, side):
    state = starts(task, 2000)
    cube, goal = state.objects["cube"].pos, state.objects["goal"].pos
    assert_fills(cube[:, 0], -0.1, 0.1)
    assert_fills(cube[:, 1], -0.1, 0.1)
    assert (cube[:, 2] == 0.02).all()
    np.testing.assert_allclose(goal[:, 0] - cube[:, 0], side * 0.2)
    np.testing.assert_array_equal(goal[:, 1], cube[:, 1])


@PAIR
@pytest.mark.parametrize(
    ("off", "solved"), [((0.0999, 0.0), True), ((0.1001, 0.0), False), ((0.08, 0.07), False)]
)
def test_success_is_the_centre_within_the_target(task, side, off, solved):
    state = starts(task)
    x, y, _ = state.objects["goal"].pos[0].tolist()
    put(state, "cube", (x + off[0], y + off[1], 0.02))
    assert task.success(state).tolist() == [solved]


def test_a_pushed_cube_stays_on_the_table():
    state = starts(PushCube())
    for z, solved in ((0.0249, True), (0.0251, False)):
        put(state, "cube", (*state.objects["goal"].pos[0, :2].tolist(), z))
        assert PushCube().success(state).tolist() == [solved]
    put(state, "cube", (*state.objects["goal"].pos[0, :2].tolist(), 0.2))
    assert PullCube().success(state).tolist() == [True]


@PAIR
def test_reward_counts_the_way_of_the_cube_from_where_the_hand_moves_it(task, side):
    """Of PushCube 5 mm behind its face, of PullCube 10 mm: ``(1 - tanh 5 d + 1 - tanh 5 g) / 3``."""
    state = starts(task)
    put(state, "cube", (0.0, 0.0, 0.02))
    put(state, "goal", (0.2 * side, 0.0, 1e-3))
    behind = -side * (0.02 + (0.005 if side > 0 else 0.01))
    state.robots["franka"].ee_pos = vector(behind, 0.0, 0.02)
    assert task.reward(state).item() == pytest.approx((1.0 + 1.0 - np.tanh(1.0)) / 3)
    state.robots["franka"].ee_pos = vector(behind, 0.0, 0.031)
    assert task.reward(state).item() == pytest.approx((1.0 - np.tanh(5 * 0.011)) / 3)


@PAIR
def test_the_expert_comes_from_the_other_side_and_ends_within_the_target(task, side):
    state = starts(task)
    cube, goal = state.objects["cube"].pos[0].numpy(), state.objects["goal"].pos[0].numpy()
    for seed in range(20):
        ways = task.expert(state, np.random.default_rng(seed))
        assert all(side * (way.pos[0] - cube[0]) < 0 for way in ways[:-1])
        assert side * (goal[0] - ways[-1].pos[0]) == pytest.approx(0.031 + 0.06)
        assert all(way.gripper == 0.0 for way in ways)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal_radius_m": -0.1}, "task_kwargs.goal_radius_m is a number of at least 0, given -0.1"),
        ({"cube_half_size_m": "big"}, "task_kwargs.cube_half_size_m is a number of at least 0, given 'big'"),
        ({"goal_gap_m": float("nan")}, "task_kwargs.goal_gap_m is a number"),
    ],
)
def test_a_wrong_size_is_named(options, message):
    with pytest.raises(ConfigError, match=message):
        PushCube(**options)
