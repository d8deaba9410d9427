"""The numbers of PushT, by hand; its stick; and pushes against a block that slides in MuJoCo."""

import numpy as np
import pytest
import torch

from envs.kinematics.forward import KinematicChain
from envs.mjcf.model import build_model
from envs.robots.franka import FRANKA, FRANKA_STICK
from envs.tasks.maniskill.push_t import END_POS_M, HOME, PushT
from envs.tasks.maniskill.tee_pushes import BARS, CONE_RAD, STEP_M, best_push, miss, moves
from tests.envs.tasks.table_states import assert_fills, put, vector

TASK = PushT()
GOAL, YAW = np.array(TASK.goal_m), TASK.goal_yaw_rad


def starts(count=1):
    state = TASK.initial_state([np.random.default_rng(row) for row in range(count)])
    state.robots["franka_stick"].ee_pos = vector(*END_POS_M, 0.024).repeat(count, 1)
    return state


def test_the_stick_starts_where_maniskill_has_its_end():
    chain = KinematicChain(TASK.robot)
    tip = chain(torch.tensor([HOME], dtype=torch.float64)).pos[0]
    np.testing.assert_allclose(tip, [*END_POS_M, 0.024], atol=1.5e-3)


def test_a_tool_is_a_body_of_the_robot_and_the_arm_has_no_fingers():
    model = build_model(TASK.scenario)
    tool = model.body("franka_stick/tool")
    assert model.body(tool.parentid[0]).name == "franka_stick/right_hand"
    assert model.site("franka_stick/tip").bodyid[0] == tool.id
    assert FRANKA_STICK.joint_names == FRANKA.joint_names[:7] and FRANKA_STICK.fingers == ()
    assert FRANKA_STICK.finger_positions(np.zeros(3)).shape == (3, 0)
    assert len(TASK.controller.names) == 7 and "gripper" not in TASK.rl_controller.names


def test_the_block_starts_in_its_box_at_any_turn():
    state = starts(4000)
    pos = state.objects["tee"].pos
    assert_fills(pos[:, 0], GOAL[0] - 0.1, GOAL[0] + 0.1)
    assert_fills(pos[:, 1], GOAL[1] - 0.1, GOAL[1] + 0.2)
    assert TASK.success(state).double().mean() < 0.01


def covering(dx=0.0, dy=0.0, turn=0.0):
    """A state in which the block is off the outline by so much in the outline's own frame."""
    state = starts()
    cosine, sine = np.cos(YAW), np.sin(YAW)
    put(
        state, "tee", (GOAL[0] + cosine * dx - sine * dy, GOAL[1] + sine * dx + cosine * dy, 0.02), YAW + turn
    )
    return state


def test_the_overlap_is_the_shared_area():
    assert float(TASK.overlap(covering())) == 1.0
    areas = [4 * half[0] * half[1] for _, half in BARS]
    # Moved by a cell along its bar: the bar loses 5 cm x 5 mm, the stem 15 cm x 5 mm.
    lost = (0.05 + 0.15) * 0.005 / sum(areas)
    assert float(TASK.overlap(covering(dx=0.005))) == pytest.approx(1.0 - lost, abs=2e-3)
    assert float(TASK.overlap(covering(dx=0.5))) == 0.0


@pytest.mark.parametrize(
    ("off", "solved"),
    [({"dx": 0.007}, True), ({"dx": 0.011}, False), ({"turn": 0.05}, True), ({"turn": 0.2}, False)],
)
def test_nine_tenths_of_the_outline_are_covered(off, solved):
    assert TASK.success(covering(**off)).tolist() == [solved]


def test_arrays_and_tensors_agree():
    state = starts(6)
    for function in (TASK.overlap, TASK.reward, TASK.observe):
        np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
    reward = TASK.reward(state)
    assert (reward >= 0.0).all() and (reward < 1.0).all()


def test_a_push_through_the_middle_turns_nothing():
    places, turns, valid = moves(np.zeros(2), 0.0)
    # At the end of the stem, towards the centre of mass.
    straight = [
        index for index in range(places.shape[1]) if abs(turns[-1, index]) < 1e-6 and valid[-1, index]
    ]
    assert straight
    for index in straight:
        assert np.linalg.norm(places[-1, index]) == pytest.approx(STEP_M * len(places), rel=1e-6)


def test_the_best_push_brings_the_block_nearer_and_is_no_steeper_than_the_cone():
    rng = np.random.default_rng(3)
    for _ in range(10):
        pos, yaw = GOAL + rng.uniform(-0.1, 0.1, 2), rng.uniform(0, 2 * np.pi)
        push = best_push(pos, yaw, GOAL, YAW)
        places, turns, valid = moves(pos, yaw)
        best = np.where(valid, miss(places, turns, GOAL, YAW), np.inf).min()
        assert best < miss(pos, np.array(yaw), GOAL, YAW)
        assert -push.direction @ push.normal >= np.cos(CONE_RAD) - 1e-9
        assert np.linalg.norm(push.direction) == pytest.approx(1.0)
