"""PickPlace with four objects: starts, rule, reward and the order of its expert, by hand."""

from itertools import combinations

import numpy as np
import pytest

from envs.robots.robosuite_arms import UR5E
from envs.tasks.robosuite.pick_place import BIN_1, CAN
from envs.tasks.robosuite.pick_place_all import PickPlace
from tests.envs.tasks.table_states import put, starts

TASK = PickPlace()
NAMES = [single.good.name for single in TASK.singles]


def placed(*names):
    state = starts(TASK)
    for single in TASK.singles:
        if single.good.name in names:
            put(state, single.good.name, (*single._goal, 0.04 + single.good.bottom_m))
    return state


def test_the_objects_start_apart_in_the_first_bin():
    assert NAMES == ["milk", "bread", "cereal", "can"]
    state = starts(TASK, 300)
    for one, other in combinations(TASK.singles, 2):
        gap = (state.objects[one.good.name].pos - state.objects[other.good.name].pos)[:, :2].norm(dim=1)
        assert (gap > one.good.radius_m + other.good.radius_m).all()
    for name in NAMES:
        off = (state.objects[name].pos[:, :2] - state.objects[name].pos.new_tensor(BIN_1[:2])).abs()
        assert (off[:, 0] < 0.195).all() and (off[:, 1] < 0.245).all()


@pytest.mark.parametrize("missing", [None, *NAMES])
def test_all_four_are_in_their_compartments(missing):
    state = placed(*(name for name in NAMES if name != missing))
    assert TASK.success(state).tolist() == [missing is None]


def test_the_hand_is_away_from_what_is_placed():
    state = placed(*NAMES)
    state.robots["franka"].ee_pos = state.objects[CAN.name].pos.clone()
    assert TASK.success(state).tolist() == [False]


def test_the_reward_grows_with_each_object_in_place():
    rewards = [float(TASK.reward(placed(*NAMES[:count]))[0]) for count in range(5)]
    assert rewards == sorted(rewards) and rewards[-1] < 1.0
    np.testing.assert_allclose(np.diff(rewards), 1 / 4.7, atol=0.03)


def test_the_expert_goes_for_what_is_left_and_has_most_room():
    state = placed("milk", "bread")
    put(state, "can", (0.1, -0.25, 0.0803))
    put(state, "cereal", (0.1, -0.15, 0.115))
    grasp = TASK.expert(state, np.random.default_rng(0))
    reached = min(grasp, key=lambda way: way.pos[2]).pos[:2]
    assert any(np.linalg.norm(reached - place) < 1e-6 for place in ((0.1, -0.25), (0.1, -0.15)))
    state = placed("milk", "bread", "cereal")
    put(state, "can", (0.1, -0.25, 0.0803))
    lowest = min(TASK.expert(state, np.random.default_rng(0)), key=lambda way: way.pos[2])
    np.testing.assert_allclose(lowest.pos[:2], (0.1, -0.25))


def test_its_parts_have_the_robot_that_does_the_task():
    assert all(single.robot is TASK.robot for single in TASK.singles)
    other = type("Other", (PickPlace,), {"robot": property(lambda _: UR5E)})()
    assert all(single.robot is UR5E for single in other.singles)


def test_arrays_and_tensors_agree():
    state = starts(TASK, 3)
    for function in (TASK.reward, TASK.success, TASK.observe):
        np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
