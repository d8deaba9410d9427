"""The numbers of LiftPegUpright, PokeCube and PegInsertionSide, by hand."""

import math

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.rotations import from_euler, rotate
from envs.tasks.maniskill.peg_insertion import PegInsertionSide
from envs.tasks.maniskill.pegs import LiftPegUpright, PokeCube
from tests.envs.tasks.table_states import assert_fills, grip, put, starts

LIFT, POKE, INSERT = LiftPegUpright(), PokeCube(), PegInsertionSide()


def leaning(tilt_rad, z=0.12):
    """A peg whose head points up, but for a tilt."""
    state = starts(LIFT)
    put(state, "peg", (0.0, 0.0, z))
    state.objects["peg"].rot = torch.from_numpy(from_euler(np.array([[0.3, tilt_rad - np.pi / 2, 0.0]])))
    return state


@pytest.mark.parametrize(
    ("tilt", "z", "solved"),
    [(0.0, 0.12, True), (0.079, 0.12, True), (0.081, 0.12, False), (0.0, 0.1249, True), (0.0, 0.1251, False)],
)
def test_an_upright_peg_stands(tilt, z, solved):
    assert LIFT.success(leaning(tilt, z)).tolist() == [solved]


def test_either_end_may_be_up_and_a_peg_held_level_is_none():
    state = leaning(0.0)
    state.objects["peg"].rot = torch.from_numpy(from_euler(np.array([[0.0, np.pi / 2, 0.0]])))
    assert LIFT.success(state).tolist() == [True]
    put(state, "peg", (0.0, 0.0, 0.12), np.pi / 2)
    assert LIFT.success(state).tolist() == [False]


def test_reward_of_a_peg_that_turns_in_the_hand():
    """Reach 0.2 and grasp 0.2 at the grip; 0.35 sin φ; 0.2 sin⁸ φ (1 - tanh 10 Δz)."""
    state = starts(LIFT)
    put(state, "peg", (0.0, 0.0, 0.025))
    grip(state, (0.09, 0.0, 0.025), 0.05)
    assert LIFT.reward(state).item() == pytest.approx(0.4)
    state = leaning(np.pi / 6)
    grip(state, (0.3, 0.3, 0.3), 0.05)
    sine = math.cos(np.pi / 6)
    reach = np.linalg.norm([0.3, 0.3, 0.3] - np.array([0.0, 0.0, 0.12]) - 0.09 * _axis(state))
    expected = 0.2 * (1 - np.tanh(5 * reach)) + 0.35 * sine + 0.2 * sine**8
    assert LIFT.reward(state).item() == pytest.approx(expected)


def _axis(state):
    return rotate(state.objects["peg"].rot[0].numpy(), np.array([1.0, 0.0, 0.0]))


def test_the_expert_turns_a_peg_about_its_tail():
    """Every place of the arc is as far from the lower edge of the tail as the grip is."""
    state = starts(LIFT)
    peg = state.objects["peg"].pos[0].numpy()
    ways = LIFT.expert(state, np.random.default_rng(0))
    edge = peg + np.array([-0.12, 0.0, -0.025])
    arc = [np.linalg.norm(way.pos - edge) for way in ways[-5:]]
    np.testing.assert_allclose(arc, arc[0])
    assert 0.2 < arc[0] < 0.22
    assert all(way.gripper == pytest.approx(0.023) for way in ways[-5:])


def test_the_expert_tips_a_peg_that_leans_in_its_fingers():
    state = leaning(0.3)
    axis = _axis(state)
    grip(state, state.objects["peg"].pos[0].numpy() + 0.08 * axis, 0.05)
    (way,) = LIFT.expert(state, np.random.default_rng(0))
    moved = (way.pos - state.robots["franka"].ee_pos[0].numpy())[:2]
    assert moved @ axis[:2] < 0.0
    assert np.linalg.norm(moved) == pytest.approx(1.2 * 0.2 * np.sin(0.3))


def test_pokecubes_start_is_a_row_of_peg_cube_and_target():
    state = starts(POKE, 2000)
    peg, cube, goal = (state.objects[name] for name in ("peg", "cube", "goal"))
    assert_fills(peg.pos[:, 0], -0.1, 0.1)
    assert_fills(cube.pos[:, 1], -0.1, 0.1)
    np.testing.assert_allclose(cube.pos[:, 0] - peg.pos[:, 0], 0.22)
    np.testing.assert_allclose(goal.pos[:, 0] - cube.pos[:, 0], 0.1)
    np.testing.assert_array_equal(goal.pos[:, 1], cube.pos[:, 1])
    assert_fills(2 * torch.atan2(cube.rot[:, 3], cube.rot[:, 0]), -np.pi / 6, np.pi / 6)


def poked(left=0.0, gap=0.0, angle=0.0, z=0.025):
    """A cube ``left`` from the target's middle, and a peg that touches it but for a gap and an angle."""
    state = starts(POKE)
    put(state, "goal", (0.3, 0.1, 1e-3))
    put(state, "cube", (0.3 - left, 0.1, 0.02), 0.2)
    turn = 0.2 + angle
    middle = np.array([0.3 - left, 0.1]) - (0.02 + gap) * np.array([np.cos(0.2), np.sin(0.2)])
    middle -= 0.12 * np.array([np.cos(turn), np.sin(turn)])
    put(state, "peg", (*middle, z), turn)
    return state


@pytest.mark.parametrize(
    ("change", "solved"),
    [
        ({}, True),
        ({"left": 0.0499}, True),
        ({"left": 0.0501}, False),
        ({"gap": 0.0049}, True),
        ({"gap": 0.0051}, False),
        ({"angle": 0.049}, True),
        ({"angle": -0.051}, False),
        ({"z": 0.0299}, True),
        ({"z": 0.0301}, False),
    ],
)
def test_a_poked_cube_is_on_the_target_and_the_peg_fits(change, solved):
    assert POKE.success(poked(**change)).tolist() == [solved]


def test_pokecubes_reward_by_hand():
    """2 (1 - tanh 5 r); held: 4 + close + in line; fitting: 7 + placed; over 9."""
    state = poked(left=0.2)
    state.robots["franka"].ee_pos = state.objects["peg"].pos + torch.tensor([0.0, 0.0, 0.1])
    assert POKE.reward(state).item() == pytest.approx(2 * (1 - np.tanh(0.5)) / 9)
    grip(state, state.objects["peg"].pos[0].tolist(), 0.05)
    left = np.hypot(0.2, 0.019)  # the target's disc is 19 mm below the cube's centre
    assert POKE.reward(state).item() == pytest.approx((7 + 1 - np.tanh(5 * left)) / 9)
    state = poked(left=0.2, gap=0.03)
    grip(state, state.objects["peg"].pos[0].tolist(), 0.05)
    assert POKE.reward(state).item() == pytest.approx((4 + 1 - np.tanh(0.25) + 1) / 9)


def test_pegs_and_boxes_start_in_maniskills_ranges():
    state = starts(INSERT, 2000)
    peg, box = state.objects["peg"], state.objects["box"]
    for values, low, high in (
        (peg.pos[:, 0], -0.1, 0.1),
        (peg.pos[:, 1], -0.3, 0.0),
        (box.pos[:, 0], -0.05, 0.05),
        (box.pos[:, 1], 0.2, 0.4),
        (2 * torch.atan2(peg.rot[:, 3], peg.rot[:, 0]), np.pi / 6, 5 * np.pi / 6),
        (2 * torch.atan2(box.rot[:, 3], box.rot[:, 0]), 3 * np.pi / 8, 5 * np.pi / 8),
    ):
        assert_fills(values, low, high)
    assert (peg.pos[:, 2] == 0.02).all() and (box.pos[:, 2] == 0.105).all()


def inserted(head=(0.0, 0.0, 0.0), task=INSERT):
    """A peg in line with its hole, whose head is at a place in the hole's frame."""
    state = starts(task)
    put(state, "box", (0.0, 0.3, 0.105), 1.4)
    ahead, left = np.array([np.cos(1.4), np.sin(1.4), 0.0]), np.array([-np.sin(1.4), np.cos(1.4), 0.0])
    y, z = task.hole_offset_m
    at = np.array([0.0, 0.3, 0.105 + z + head[2]]) + (head[0] - 0.105) * ahead + (y + head[1]) * left
    put(state, "peg", at, 1.4)
    return state


@pytest.mark.parametrize(
    ("head", "solved"),
    [
        ((0.0, 0.0, 0.0), True),
        ((-0.0149, 0.0229, -0.0229), True),
        ((-0.0151, 0.0, 0.0), False),
        ((0.0151, 0.0, 0.0), True),  # further in: ManiSkill has no limit there
        ((0.0, 0.0231, 0.0), False),
        ((0.0, 0.0, -0.0231), False),
    ],
)
@pytest.mark.parametrize("task", [INSERT, PegInsertionSide(hole_offset_m=(0.03, -0.02))])
def test_a_peg_is_inserted_to_the_middle_of_the_box_at_least(task, head, solved):
    assert task.success(inserted(head, task)).tolist() == [solved]


def test_the_hole_is_as_wide_as_the_peg_and_its_clearance():
    """Rays through the box along the hole's edge, 3 mm outside the peg, and just beyond it."""
    walls = PegInsertionSide(hole_offset_m=(0.03, -0.02)).objects[1].geoms

    def blocked(y, z):
        return any(
            abs(y - wall.pos[1]) < wall.size[1] and abs(z - wall.pos[2]) < wall.size[2] for wall in walls
        )

    for y, z in ((0.0229, 0.0), (-0.0229, 0.0), (0.0, 0.0229), (0.0, -0.0229)):
        assert not blocked(0.03 + y, -0.02 + z)
    for y, z in ((0.0231, 0.001), (-0.0231, 0.001), (0.001, 0.0231), (0.001, -0.0231)):
        assert blocked(0.03 + y, -0.02 + z)
    assert {wall.size[0] for wall in walls} == {0.105}
    assert blocked(0.104, 0.104) and not blocked(0.106, 0.0)


def test_a_hole_outside_of_the_box_is_refused():
    with pytest.raises(ConfigError, match=r"hole_offset_m leaves the box: each part is below 0\.082 m"):
        PegInsertionSide(hole_offset_m=(0.0, 0.09))


def test_insertions_reward_by_hand():
    """Reach; with a grasp 1, 3 (1 - tanh(0.5 Σ + 4.5 max)) for the axis, and 5 for the depth; over 10."""
    state = inserted((-0.1, 0.0, 0.0))
    peg = state.objects["peg"].pos[0].numpy()
    grip(state, peg - 0.06 * np.array([np.cos(1.4), np.sin(1.4), 0.0]), 0.04)
    expected = (1 + 1 + 3 + 5 * (1 - np.tanh(0.5))) / 10
    assert INSERT.reward(state).item() == pytest.approx(expected)
    state = inserted((-0.1, 0.02, 0.0))
    peg = state.objects["peg"].pos[0].numpy()
    grip(state, peg - 0.06 * np.array([np.cos(1.4), np.sin(1.4), 0.0]), 0.04)
    assert INSERT.reward(state).item() == pytest.approx((1 + 1 + 3 * (1 - np.tanh(0.02 + 0.09))) / 10)
