"""The numbers of TwoArmHandover and of its hammer, by hand."""

import math

import numpy as np
import pytest
import torch

from envs.mjcf.model import build_model
from envs.rotations import from_yaw, multiply, rotate
from envs.tasks.robosuite.hammer import LYING, axis_of
from envs.tasks.robosuite.two_arm_handover import TwoArmHandover
from tests.envs.tasks.robosuite.test_two_arms import LEFT, RIGHT, grip, starts
from tests.envs.tasks.table_states import assert_fills, vector

TASK = TwoArmHandover()
WIDTH_M = 2 * TASK.handle_radius_m


def held(height_m=0.3, left=False, right=True):
    """A level hammer along y at a height; who holds it does so 4 cm from its middle."""
    state = starts(TASK)
    hammer = state.objects["hammer"]
    hammer.pos = vector(0.0, 0.0, height_m)
    hammer.rot = torch.from_numpy(multiply(from_yaw(np.array(math.pi / 2)), LYING[0]))[None]
    for name, holds, y in ((LEFT, left, -0.04), (RIGHT, right, 0.04)):
        if holds:
            grip(state, name, (0.0, y, height_m), WIDTH_M)
    return state


def test_the_hammer_starts_flat_on_either_side_at_any_turn():
    state = starts(TASK, 2000)
    hammer = state.objects["hammer"]
    assert_fills(hammer.pos[:, 0], -0.1, 0.1)
    assert_fills(hammer.pos[:, 1], -0.05, 0.05)
    axis = axis_of(hammer)
    assert axis[:, 2].abs().max() < 0.012, "it lies on its head, which is thicker than the handle"
    assert_fills(torch.atan2(axis[:, 1], axis[:, 0]), -math.pi, math.pi)
    face = rotate(hammer.rot, vector(1.0, 0.0, 0.0))
    turned = axis[:, 0] * face[:, 1] - axis[:, 1] * face[:, 0]
    assert 0.4 < (turned > 0).double().mean() < 0.6, "both ways to lie"
    assert face[:, 2].abs().max() < 1e-9


def test_the_hammer_has_robosuites_mass():
    r, h = 0.0175, 1.1 * 0.0175
    head = 8 * (2 * h) * h * h + 8 * 0.7072 * h * 0.95 * h * 0.7072 * h
    head += 2 * math.pi * ((0.8 * h) ** 2 * 0.2 * h + h**2 * 0.4 * h)
    mass = 175 * (4 * r * r * 0.175 + 2 * head)
    assert build_model(TASK.scenario).body("hammer").mass[0] == pytest.approx(mass)


@pytest.mark.parametrize(
    ("who", "solved"),
    [
        ({"right": True}, True),
        ({"right": False}, False),
        ({"left": True, "right": True}, False),
        ({"left": True, "right": False}, False),
    ],
)
def test_the_right_arm_holds_the_handle_alone(who, solved):
    assert TASK.success(held(**who)).tolist() == [solved]


@pytest.mark.parametrize(("above", "solved"), [(0.0999, False), (0.1001, True)])
def test_the_hammer_is_lifted(above, solved):
    assert TASK.success(held(TASK.handle_radius_m + above)).tolist() == [solved]


def test_a_hammer_that_hangs_from_the_hand_is_as_high_as_its_lower_end():
    state = held()
    hammer = state.objects["hammer"]
    hammer.rot = vector(1.0, 0.0, 0.0, 0.0)  # the head is up
    reach = TASK.handle_length_m / 2 + 2 * TASK.hammer.head_m
    assert float(TASK.hammer.height(hammer)[0]) == pytest.approx(0.3 - TASK.handle_radius_m - reach)


def test_the_head_is_a_part_for_the_left_hand_and_no_handle_for_the_right():
    state = held(right=False)
    head_y = TASK.handle_length_m / 2 + 0.035
    axis = axis_of(state.objects["hammer"])[0].numpy()
    for name in (LEFT, RIGHT):
        grip(state, name, np.array([0.0, 0.0, 0.3]) + head_y * axis, WIDTH_M)
    left, right = TASK._holds(state)
    assert left.tolist() == [True] and right.tolist() == [False]


def test_the_reward_grows_from_reach_to_handover():
    low, high = TASK.handle_radius_m, 0.3
    states = [
        held(low, right=False),
        held(low, left=True, right=False),
        held(high, left=True, right=False),
        held(high, left=True, right=True),
        held(high),
    ]
    rewards = [float(TASK.reward(state)[0]) for state in states]
    assert rewards == sorted(rewards) and len(set(rewards)) == 5 and rewards[-1] < 1.0


def test_arrays_and_tensors_agree():
    state = starts(TASK, 4)
    for function in (TASK.reward, TASK.success, TASK.observe):
        np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
