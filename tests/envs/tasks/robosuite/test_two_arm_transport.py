"""The numbers of TwoArmTransport, by hand."""

import math

import numpy as np
import pytest
import torch

from envs.mjcf.model import build_model
from envs.rotations import rotate
from envs.tasks.robosuite.hammer import axis_of
from envs.tasks.robosuite.two_arm_transport import PAYLOAD, TwoArmTransport
from tests.envs.tasks.robosuite.test_two_arms import starts
from tests.envs.tasks.table_states import assert_fills, put, vector

TASK = TwoArmTransport()


def felt(payload, trash):
    state = starts(TASK)
    for name, touches in (("payload", payload), ("trash", trash)):
        state.objects[name].touched = torch.tensor([[float(touches)]])
    return state


def test_robots_stand_beyond_both_tables():
    assert [robot.pos[1] for robot in TASK.robots] == [-0.81, 0.81]
    tables = {"left": TASK.table.pos[1], "right": TASK.scenario.object("table_right").pos[1]}
    assert tables == {"left": -0.45, "right": 0.45}


def test_both_tables_stand_on_the_ground_on_four_legs():
    boards = TASK.scenario.object("table_right").geoms
    assert [geom.collides for geom in boards] == [True, False, False, False, False]
    for leg in boards[1:]:
        assert leg.pos[2] + leg.size[2] == pytest.approx(-TASK.table.thickness_m)
        assert leg.pos[2] - leg.size[2] == pytest.approx(-TASK.table.height_m)


def test_bins_are_within_half_a_centimetre_of_their_places_and_hold_what_they_should():
    state = starts(TASK, 2000)
    for name, x, y in (("start", 0.2, -0.45), ("target", -0.2, 0.45), ("trash", 0.2, 0.45)):
        floor, walls = state.objects[f"{name}_floor"].pos, state.objects[f"{name}_walls"].pos
        assert torch.equal(floor[:, :2], walls[:, :2])
        assert_fills(floor[:, 0], x - 0.005, x + 0.005)
        assert_fills(floor[:, 1], y - 0.005, y + 0.005)
    for name, place, most in (("payload", "start", 0.006), ("lid", "start", 0.0), ("trash", "target", 0.0)):
        off = state.objects[name].pos[:, :2] - state.objects[f"{place}_floor"].pos[:, :2]
        assert off.abs().max() <= most


def test_the_head_of_a_hammer_that_is_turned_far_starts_clear_of_the_walls():
    state = starts(TASK, 500)
    hammer = state.objects["payload"]
    off = hammer.pos - state.objects["start_floor"].pos
    end, h = PAYLOAD.length_m / 2, PAYLOAD.head_m
    for x in (-3.2 * h, 3.2 * h):
        corner = off + rotate(hammer.rot, vector(x, 0.0, end + 2 * h))
        assert (corner[:, :2].abs() < 0.14).all()


def test_the_hammer_lies_along_the_way_to_the_other_table_within_30_degrees():
    state = starts(TASK, 2000)
    axis = axis_of(state.objects["payload"])
    assert axis[:, 2].abs().max() < 0.01, "it lies on its head, which is thicker than the handle"
    turn = torch.atan2(axis[:, 1].abs(), axis[:, 0])
    assert_fills(turn, math.pi / 3, 2 * math.pi / 3)
    assert 0.4 < (axis[:, 1] > 0).double().mean() < 0.6
    # As robosuite's sampler leaves it: the face is on the side of -x.
    assert (rotate(state.objects["payload"].rot, vector(1.0, 0.0, 0.0))[:, 0] < 0.0).all()


@pytest.mark.parametrize("payload", [False, True])
@pytest.mark.parametrize("trash", [False, True])
def test_both_touch_the_floors_of_their_bins(payload, trash):
    assert TASK.success(felt(payload, trash)).tolist() == [payload and trash]


def test_places_say_it_where_a_simulator_does_not():
    state = starts(TASK)
    for name, place, height in (("payload", "target", 0.03), ("trash", "trash", 0.03)):
        put(state, name, (*state.objects[f"{place}_floor"].pos[0, :2].tolist(), height))
        state.objects[name].touched = None
    assert TASK.success(state).tolist() == [True]
    state.objects["payload"].pos[:, 2] = 0.2
    assert TASK.success(state).tolist() == [False]


def test_lid_and_hammer_have_robosuites_mass():
    model = build_model(TASK.scenario)
    lid = 250 * 0.3 * 0.3 * 0.01 + 500 * 0.02 * 0.08 * 0.03
    assert model.body("lid").mass[0] == pytest.approx(lid)
    handle = 150 * 0.03 * 0.03 * 0.2
    assert model.body("payload").mass[0] > handle
    assert PAYLOAD.head_m == pytest.approx(0.0165)


def test_the_reward_grows_as_each_comes_nearer_to_its_bin():
    state = starts(TASK)
    rewards = [float(TASK.reward(state)[0])]
    for name, place in (("trash", "trash"), ("payload", "target")):
        put(state, name, state.objects[f"{place}_floor"].pos[0].tolist())
        rewards.append(float(TASK.reward(state)[0]))
    assert rewards == sorted(rewards) and rewards[-1] == pytest.approx(0.99)


def test_arrays_and_tensors_agree():
    state = starts(TASK, 4)
    for name in ("payload", "trash"):
        state.objects[name].touched = torch.zeros((4, 1), dtype=torch.float64)
    for function in (TASK.reward, TASK.success, TASK.observe):
        np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
