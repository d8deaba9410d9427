"""The numbers of TwoRobotPickCube and TwoRobotStackCube, by hand."""

import numpy as np
import pytest
import torch

from envs.tasks.maniskill.two_robots import LEFT, RIGHT, TwoRobotPickCube, TwoRobotStackCube
from tests.envs.tasks.table_states import assert_fills, put, vector

PICK, STACK = TwoRobotPickCube(), TwoRobotStackCube()


def starts(task, count=1):
    """Initial states, completed as a simulator does: open hands above their own halves, at rest."""
    state = task.initial_state([np.random.default_rng(row) for row in range(count)])
    for robot, y in ((LEFT, -0.4), (RIGHT, 0.4)):
        entity = state.robots[robot.name]
        entity.ee_pos = vector(0.0, y, 0.3).repeat(count, 1)
        entity.ee_rot = vector(0.0, 1.0, 0.0, 0.0).repeat(count, 1)
        entity.joint_target = entity.joint_pos.clone()
    return state


def grip(state, robot, pos, width_m=0.04):
    entity = state.robots[robot.name]
    entity.ee_pos = vector(*pos)
    entity.joint_pos[:, 7:], entity.joint_target[:, 7:] = width_m / 2, 0.0


def test_robots_face_each_other_and_the_cube_starts_on_the_left():
    assert LEFT.pos == (0.0, -0.75, 0.0) and RIGHT.pos == (0.0, 0.75, 0.0)
    state = starts(PICK, 2000)
    cube, goal = state.objects["cube"].pos, state.objects["goal"].pos
    for values, low, high in (
        (cube[:, 0], -0.05, 0.05),
        (cube[:, 1], -0.2, -0.1),
        (goal[:, 0], -0.05, 0.05),
        (goal[:, 1], 0.1, 0.2),
        (goal[:, 2], 0.02, 0.32),
    ):
        assert_fills(values, low, high)


@pytest.mark.parametrize(("off", "solved"), [(0.0249, True), (0.0251, False)])
def test_the_cube_is_at_the_goal(off, solved):
    state = starts(PICK)
    put(state, "goal", (0.0, 0.15, 0.2))
    put(state, "cube", (0.0, 0.15, 0.2 + off))
    assert PICK.success(state).tolist() == [solved]


def test_the_right_arm_is_still_at_the_goal_and_the_left_one_may_move():
    state = starts(PICK)
    put(state, "goal", (0.0, 0.15, 0.2))
    put(state, "cube", (0.0, 0.15, 0.2))
    state.robots[LEFT.name].joint_vel[:, 3] = 1.0
    assert PICK.success(state).tolist() == [True]
    for speed, solved in ((0.199, True), (0.201, False)):
        state.robots[RIGHT.name].joint_vel[:, 3] = speed
        assert PICK.success(state).tolist() == [solved]


def test_the_reward_of_pick_cube_grows_by_stages_and_stays_below_1():
    state = starts(PICK)
    put(state, "goal", (0.0, 0.15, 0.2))
    put(state, "cube", (0.0, -0.15, 0.02))
    rewards = [PICK.reward(state)]
    put(state, "cube", (0.0, 0.05, 0.02))
    rewards.append(PICK.reward(state))
    grip(state, RIGHT, (0.0, 0.05, 0.02))
    rewards.append(PICK.reward(state))
    put(state, "cube", (0.0, 0.15, 0.2))
    grip(state, RIGHT, (0.0, 0.15, 0.2))
    rewards.append(PICK.reward(state))
    values = torch.cat(rewards).tolist()
    assert values == sorted(values) and len(set(values)) == 4 and values[0] >= 0.0 and values[-1] < 1.0


def stacked(a=(0.0, 0.0, 0.04), b=(0.0, 0.0)):
    state = starts(STACK)
    put(state, "goal", (0.0, -0.1, 0.001))
    base = np.array([b[0], -0.1 + b[1], 0.02])
    put(state, "cube_b", base)
    put(state, "cube_a", base + a)
    return state


@pytest.mark.parametrize(
    ("a", "b", "solved"),
    [
        ((0.0, 0.0, 0.04), (0.0, 0.0), True),
        ((0.0332, 0.0, 0.0449), (0.0, 0.0599), True),
        ((0.0334, 0.0, 0.04), (0.0, 0.0), False),
        ((0.0, 0.0, 0.0451), (0.0, 0.0), False),
        ((0.0, 0.0, 0.04), (0.0, 0.0601), False),
    ],
)
def test_the_blue_cube_is_on_the_green_one_on_the_target(a, b, solved):
    assert STACK.success(stacked(a, b)).tolist() == [solved]


def test_both_cubes_are_let_go():
    for robot, height in ((LEFT, 0.06), (RIGHT, 0.02)):
        state = stacked()
        grip(state, robot, (0.0, -0.1, height))
        assert STACK.success(state).tolist() == [False]


def test_cubes_to_stack_start_on_their_own_halves():
    state = starts(STACK, 2000)
    assert_fills(state.objects["cube_a"].pos[:, 1], -0.2, -0.1)
    assert_fills(state.objects["cube_b"].pos[:, 1], 0.1, 0.2)
    assert_fills(state.objects["goal"].pos[:, 0], -0.05, 0.05)
    assert (state.objects["goal"].pos[:, 1] == -0.1).all()


def test_rewards_take_arrays_as_they_take_tensors():
    for task in (PICK, STACK):
        state = starts(task, 5)
        for function in (task.reward, task.success, task.observe):
            np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
