"""The numbers of Lift, Stack and the single PickPlace tasks, by hand."""

import numpy as np
import pytest
import torch

from envs.tasks.robosuite.cubes import Lift, Stack
from envs.tasks.robosuite.pick_place import (
    PickPlaceBread,
    PickPlaceCan,
    PickPlaceCereal,
    PickPlaceMilk,
)
from tests.envs.tasks.table_states import assert_fills, grip, put, starts, vector

LIFT, STACK, CAN = Lift(), Stack(), PickPlaceCan()


def test_the_robot_is_where_robosuite_puts_it():
    """Base at 0.912 m, tables at 0.8 m, the bins' lower side at 0.78 m."""
    np.testing.assert_allclose(LIFT.scenario.robots[0].pos, (-0.56, 0.0, 0.112))
    np.testing.assert_allclose(CAN.scenario.robots[0].pos, (-0.5, -0.1, 0.132))


def test_lifts_cube_starts_in_the_middle_with_any_yaw():
    state = starts(LIFT, 2000)
    cube = state.objects["cube"]
    assert_fills(cube.pos[:, 0], -0.03, 0.03)
    assert_fills(cube.pos[:, 1], -0.03, 0.03)
    assert (cube.pos[:, 2] == 0.021).all()
    assert abs((2 * torch.atan2(cube.rot[:, 3], cube.rot[:, 0])).cos().mean()) < 0.05


@pytest.mark.parametrize(("z", "solved"), [(0.0401, True), (0.0399, False)])
def test_a_lifted_cube_is_4_cm_high(z, solved):
    state = starts(LIFT)
    put(state, "cube", (0.0, 0.0, z))
    assert LIFT.success(state).tolist() == [solved]


def test_lifts_reward_by_hand():
    state = starts(LIFT)
    put(state, "cube", (0.0, 0.0, 0.1))
    assert LIFT.reward(state).item() == pytest.approx((1 - np.tanh(2.0)) / 2.25)
    grip(state, (0.0, 0.0, 0.1), 0.042)
    assert LIFT.reward(state).item() == pytest.approx(1.25 / 2.25)


def test_stacks_cubes_start_apart():
    state = starts(STACK, 2000)
    a, b = state.objects["cube_a"].pos, state.objects["cube_b"].pos
    assert_fills(a[:, 0], -0.08, 0.08)
    assert_fills(b[:, 1], -0.08, 0.08)
    assert torch.linalg.vector_norm((a - b)[:, :2], dim=-1).min() > np.sqrt(2) * 0.045
    assert (a[:, 2] == 0.02).all() and (b[:, 2] == 0.025).all()


def stacked(z=0.07, touches=1.0):
    state = starts(STACK)
    put(state, "cube_b", (0.0, 0.0, 0.025))
    put(state, "cube_a", (0.01, 0.0, z))
    state.objects["cube_a"].touched = vector(touches)
    return state


def test_a_stacked_cube_is_high_touches_the_other_and_is_let_go():
    assert STACK.success(stacked()).tolist() == [True]
    assert STACK.success(stacked(z=0.0399)).tolist() == [False]
    assert STACK.success(stacked(touches=0.0)).tolist() == [False]
    state = stacked()
    grip(state, (0.01, 0.0, 0.07), 0.04)
    assert STACK.success(state).tolist() == [False]


@pytest.mark.parametrize(("z", "solved"), [(0.07, True), (0.0719, True), (0.0721, False)])
def test_where_touches_are_not_known_places_decide(z, solved):
    state = stacked(z=z)
    state.objects["cube_a"].touched = None
    assert STACK.success(state).tolist() == [solved]


def test_stacks_reward_by_hand():
    """Below 4 cm 0.25 reach + 0.25 grasp, above 1 + 0.5 (1 - tanh d); over 2."""
    state = stacked(z=0.02)
    grip(state, (0.01, 0.0, 0.02), 0.04)
    assert STACK.reward(state).item() == pytest.approx(0.25)
    assert STACK.reward(stacked(z=0.1)).item() == pytest.approx((1 + 0.5 * (1 - np.tanh(0.01))) / 2)


COMPARTMENTS = [
    (CAN, "can", (0.1975, 0.4025)),
    (PickPlaceMilk(), "milk", (0.0025, 0.1575)),
    (PickPlaceBread(), "bread", (0.1975, 0.1575)),
    (PickPlaceCereal(), "cereal", (0.0025, 0.4025)),
]


@pytest.mark.parametrize(("task", "name", "middle"), COMPARTMENTS)
def test_every_object_has_its_quarter_of_the_second_bin(task, name, middle):
    """Quarters of 0.39 m by 0.49 m round (0.1, 0.28)."""
    x, y = middle
    for dx, dy, z, solved in (
        (0.0, 0.0, 0.05, True),
        (0.0974, 0.1224, 0.05, True),
        (0.0976, 0.0, 0.05, False),
        (0.0, -0.1226, 0.05, False),
        (0.0, 0.0, 0.0199, False),
        (0.0, 0.0, 0.1199, True),
        (0.0, 0.0, 0.1201, False),
    ):
        state = starts(task)
        put(state, name, (x + dx, y + dy, z))
        assert task.success(state).tolist() == [solved], (dx, dy, z)


def test_the_hand_is_away_from_a_placed_object():
    """1 - tanh(10 d) < 0.6: farther than atanh(0.4) / 10 = 42.4 mm."""
    for away, solved in ((0.0425, True), (0.0423, False)):
        state = starts(CAN)
        put(state, "can", (0.2, 0.4, 0.08))
        state.robots["franka"].ee_pos = vector(0.2, 0.4, 0.08 + away)
        assert CAN.success(state).tolist() == [solved]


@pytest.mark.parametrize(("task", "name", "middle"), COMPARTMENTS)
def test_objects_start_on_the_floor_of_the_first_bin(task, name, middle):
    state, good = starts(task, 1000), task.good
    pos = state.objects[name].pos
    assert_fills(pos[:, 0], 0.1 - 0.145 + good.radius_m, 0.1 + 0.145 - good.radius_m)
    assert_fills(pos[:, 1], -0.25 - 0.195 + good.radius_m, -0.25 + 0.195 - good.radius_m)
    np.testing.assert_allclose(pos[:, 2], 0.04 + good.bottom_m)


def test_pick_places_reward_by_hand():
    state = starts(CAN)
    put(state, "can", (0.1, -0.25, 0.08))
    state.robots["franka"].ee_pos = vector(0.1, -0.25, 0.18)
    far = np.hypot(0.0975, 0.6525)
    hover = 0.2 * (1 - np.tanh(10 * far))
    assert CAN.reward(state).item() == pytest.approx(max(0.1 * (1 - np.tanh(1.0)), hover))
    grip(state, (0.1, -0.25, 0.08), 0.05)
    lift = 0.35 + 0.15 * (1 - np.tanh(15 * 0.19))
    assert CAN.reward(state).item() == pytest.approx(lift + hover)
    put(state, "can", (0.1975, 0.3525, 0.3))
    assert CAN.reward(state).item() == pytest.approx(0.5 + 0.2 * (1 - np.tanh(0.5)))


def test_the_expert_takes_a_cereal_box_by_its_thin_side():
    """At turn 0 fingers close along y: the box, 3 cm along its own y, is met with its heading."""
    task = PickPlaceCereal()
    for yaw, turn in ((0.4, 0.4), (3.0, 3.0 - np.pi), (-1.2, -1.2)):
        state = starts(task)
        put(state, "cereal", (0.1, -0.25, 0.115), yaw)
        closing = next(way for way in task.expert(state, np.random.default_rng(0)) if way.gripper == 0.0)
        assert closing.yaw == pytest.approx(turn)
