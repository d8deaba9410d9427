"""The numbers of robosuite's tasks of two arms, by hand."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from envs.mjcf.model import build_model
from envs.rotations import from_matrix, from_yaw, to_matrix
from envs.tasks.robosuite.two_arm_lift import HANDLES, TwoArmLift
from envs.tasks.robosuite.two_arm_peg_in_hole import FREE_M, HOLE_POS, MEETING_M, PLATE_POS, TwoArmPegInHole
from envs.tasks.robosuite.two_arms import AT_TABLE
from envs.tasks.tabletop import point_on
from tests.envs.tasks.table_states import assert_fills, put, vector

LIFT, PEG = TwoArmLift(), TwoArmPegInHole()
LEFT, RIGHT = "franka_left", "franka_right"


def starts(task, count=1):
    state = task.initial_state([np.random.default_rng(row) for row in range(count)])
    for name, y in ((LEFT, -0.3), (RIGHT, 0.3)):
        robot = state.robots[name]
        robot.ee_pos = vector(0.0, y, 0.3).repeat(count, 1)
        robot.ee_rot = vector(0.0, 1.0, 0.0, 0.0).repeat(count, 1)
        robot.joint_target = robot.joint_pos.clone()
    return state


def grip(state, name, pos, width_m):
    robot = state.robots[name]
    robot.ee_pos = torch.as_tensor(np.atleast_2d(pos), dtype=torch.float64)
    robot.joint_pos[:, 7:], robot.joint_target[:, 7:] = width_m / 2, 0.0


def test_robots_face_each_other_on_pedestals():
    left, right = AT_TABLE
    assert (left.pos, right.pos) == ((0.0, -0.56, pytest.approx(0.112)), (0.0, 0.56, pytest.approx(0.112)))
    np.testing.assert_allclose(left.rot, from_yaw(np.array(math.pi / 2)), atol=1e-12)
    pedestals = [item for item in LIFT.objects if item.name.startswith("pedestal")]
    assert [item.rot for item in pedestals] == [left.rot, right.rot]


def test_the_pot_has_robosuites_mass_and_its_handles_point_at_the_robots():
    model = build_model(LIFT.scenario)
    # Base and four walls of 1 cm, two handles of three bars, at 1000 kg/m³.
    shell = 0.14 * 0.14 * 0.01 + 4 * 0.01 * 0.14 * 0.14
    handles = 2 * (0.11 * 0.02 * 0.02 + 2 * 0.02 * 0.09 * 0.02)
    assert model.body("pot").mass[0] == pytest.approx(1000 * (shell + handles))
    state = starts(LIFT, 1000)
    first, second = (point_on(state.objects["pot"], handle)[:, 1] for handle in HANDLES)
    assert (first < second).all()
    assert_fills(state.objects["pot"].pos[:, 0], -0.03, 0.03)


@pytest.mark.parametrize(("bottom", "solved"), [(0.0999, False), (0.1001, True)])
def test_the_pot_is_lifted(bottom, solved):
    state = starts(LIFT)
    put(state, "pot", (0.0, 0.0, 0.07 + bottom))
    assert LIFT.success(state).tolist() == [solved]


def test_each_hand_is_rewarded_for_its_own_handle_and_a_tilted_pot_is_not():
    state = starts(LIFT)
    put(state, "pot", (0.0, 0.0, 0.07), math.pi)
    rewards = [float(LIFT.reward(state)[0])]
    for name, handle in zip((LEFT, RIGHT), HANDLES, strict=True):
        grip(state, name, point_on(state.objects["pot"], handle), 0.02)
        rewards.append(float(LIFT.reward(state)[0]))
    assert rewards == sorted(rewards)
    # Both handles reached and grasped: 2 * (0.5 + 0.25) of 3.
    assert rewards[-1] == pytest.approx(0.5)
    put(state, "pot", (0.0, 0.0, 0.07 + 0.15), math.pi)
    for name, handle in zip((LEFT, RIGHT), HANDLES, strict=True):
        grip(state, name, point_on(state.objects["pot"], handle), 0.02)
    assert float(LIFT.reward(state)[0]) == pytest.approx((1.5 + 1.0) / 3)
    tilt = from_matrix(np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]))  # 37 degrees
    state.objects["pot"].rot = torch.from_numpy(tilt)[None]
    assert float(LIFT.reward(state)[0]) < 0.5


def facing_state(along=0.1, off=0.0, angle=0.0):
    """The hole's middle so far ahead of the peg and beside it, the plate's normal turned by an angle."""
    state = starts(PEG)
    left, right = state.robots[LEFT], state.robots[RIGHT]
    ahead = np.stack([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], axis=1)  # z is along +y
    left.ee_pos, left.ee_rot = vector(0.0, 0.0, 1.0), torch.from_numpy(from_matrix(ahead))[None]
    plate = to_matrix(from_yaw(np.array(angle))) @ np.stack([[-1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]], axis=1)
    right.ee_pos = vector(off, along, 1.0)
    right.ee_rot = torch.from_numpy(from_matrix(plate))[None]
    return state


@pytest.mark.parametrize(
    ("fit", "solved"),
    [
        ({"along": 0.139}, True),
        ({"along": 0.141}, False),
        ({"along": -0.119}, True),
        ({"along": -0.121}, False),
        ({"off": 0.059}, True),
        ({"off": 0.061}, False),
        ({"angle": 0.317}, True),
        ({"angle": 0.319}, False),
    ],
)
def test_the_peg_is_in_the_hole(fit, solved):
    assert PEG.success(facing_state(**fit)).tolist() == [solved]


def test_how_a_peg_fits_is_measured_along_it():
    fit = PEG.fit(facing_state(along=0.1, off=0.03, angle=0.2))
    assert float(fit.along[0]) == pytest.approx(0.1)
    assert float(fit.off[0]) == pytest.approx(0.03)
    assert float(fit.cosine[0]) == pytest.approx(math.cos(0.2))


def test_the_hole_is_held_still_once_it_is_where_they_meet():
    """A new plan aims the peg at where the hole is, not at where it was to be."""
    state = facing_state(along=0.5)
    first = PEG.phases(state, np.random.default_rng(0))
    assert len(first[0][RIGHT]) == 1 and len(first[0][LEFT]) > 1
    place = MEETING_M + np.array([0.02, -0.01, 0.03])
    state.robots[LEFT].ee_pos = vector(place[0], place[1] - FREE_M, place[2])
    state.robots[RIGHT].ee_pos = vector(*place)
    (phase,) = PEG.phases(state, np.random.default_rng(0))
    (inserts,) = phase[LEFT]
    assert not phase[RIGHT]
    moved = inserts.pos - PEG.commanded(state).pos
    assert moved[1] == pytest.approx(FREE_M - 0.08, abs=0.021)
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-9)


def test_plate_and_peg_are_tools_of_the_size_that_robosuite_gives():
    model = build_model(PEG.scenario)
    volume = 2 * 0.12 * 0.34 * 0.02 + 2 * 0.1 * 0.12 * 0.02
    assert model.body(f"{RIGHT}/tool").mass[0] == pytest.approx(1000 * volume)
    assert model.body(f"{LEFT}/tool").mass[0] == pytest.approx(1000 * math.pi * 0.0225**2 * 0.26)
    # The rule measures from 0.1 m along the plate, which points against the flange's x axis.
    assert PLATE_POS[0] - HOLE_POS[0] == pytest.approx(0.1)
    thick = dataclasses.replace(PEG, peg_radius_m=0.03)
    assert thick.robots[0].tool[0].size[0] == 0.03 and len(thick.controller.names) == 14


def test_arrays_and_tensors_agree():
    for task, state in ((LIFT, starts(LIFT, 4)), (PEG, starts(PEG, 4))):
        for function in (task.reward, task.success, task.observe):
            np.testing.assert_allclose(function(state.arrays()), function(state).numpy(), atol=1e-9)
        reward = task.reward(state)
        assert (reward >= 0.0).all() and (reward < 1.0).all()
