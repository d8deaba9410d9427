"""PlugCharger's numbers, by hand."""

import numpy as np
import pytest
import torch

from envs.rotations import from_euler, from_yaw, multiply
from envs.tasks.maniskill.plug_charger import PlugCharger
from tests.envs.tasks.table_states import assert_fills, grip, put, starts

TASK = PlugCharger()


def plugged(left=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    """A charger in its receptacle, but for a way in the charger's own directions and a turn."""
    state = starts(TASK)
    put(state, "receptacle", (0.05, 0.02, 0.1), np.pi + 0.3)
    cos, sin = np.cos(0.3), np.sin(0.3)
    way = (cos * left[0] - sin * left[1], sin * left[0] + cos * left[1], left[2])
    put(state, "charger", np.array([0.05, 0.02, 0.1]) + way)
    rot = multiply(from_yaw(np.array([0.3])), from_euler(np.array([turn])))
    state.objects["charger"].rot = torch.from_numpy(rot)
    return state


def test_charger_and_receptacle_start_in_maniskills_ranges():
    state = starts(TASK, 2000)
    charger, receptacle = state.objects["charger"], state.objects["receptacle"]
    for values, low, high in (
        (charger.pos[:, 0], -0.1, -0.026),
        (charger.pos[:, 1], -0.2, 0.2),
        (receptacle.pos[:, 0], 0.01, 0.1),
        (receptacle.pos[:, 1], -0.1, 0.1),
        (2 * torch.atan2(charger.rot[:, 3], charger.rot[:, 0]), -np.pi / 3, np.pi / 3),
        ((2 * torch.atan2(receptacle.rot[:, 3], receptacle.rot[:, 0])) % (2 * np.pi), 2.7489, 3.5343),
    ):
        assert_fills(values, low, high)
    assert (charger.pos[:, 2] == 0.012).all() and (receptacle.pos[:, 2] == 0.1).all()


@pytest.mark.parametrize(
    ("left", "turn", "solved"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        ((-0.0049, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        ((-0.0051, 0.0, 0.0), (0.0, 0.0, 0.0), False),
        ((0.0, 0.003, 0.0041), (0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), (0.199, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), (0.201, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), (0.0, -0.199, 0.0), True),
        ((0.0, 0.0, 0.0), (0.0, 0.201, 0.0), False),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.201), False),
        ((0.0, 0.0, 0.0), (0.15, 0.15, 0.0), False),  # about 0.21 rad together
        ((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), False),
    ],
)
def test_a_plugged_charger_is_in_its_place(left, turn, solved):
    assert TASK.success(plugged(left, turn)).tolist() == [solved]


def test_holes_are_half_a_millimetre_wider_than_pins():
    beams = [geom for geom in TASK.objects[1].geoms if geom.collides]

    def blocked(y, z):
        return any(
            abs(y - beam.pos[1]) < beam.size[1] and abs(z - beam.pos[2]) < beam.size[2] for beam in beams
        )

    for side in (-1, 1):
        for y in (0.00576, 0.007, 0.00824):
            assert not blocked(side * y, 0.0) and not blocked(side * y, 0.00369)
        for y, z in ((0.00574, 0.0), (0.00826, 0.0), (0.007, 0.00371)):
            assert blocked(side * y, z)
    assert blocked(0.0, 0.001) and blocked(0.0499, 0.0499)
    assert {beam.pos[0] for beam in beams} == {-0.01}


def test_reward_by_hand():
    """0.2 reach; held 0.2 + 0.3 in line + 0.25 near."""
    state = plugged((-0.05, 0.0, 0.0))
    body = state.objects["charger"].pos[0].numpy() - 0.02 * np.array([np.cos(0.3), np.sin(0.3), 0.0])
    grip(state, body, 0.03)
    assert TASK.reward(state).item() == pytest.approx(0.2 + 0.2 + 0.3 + 0.25 * (1 - np.tanh(0.25)))
    grip(state, np.add(body, (0.0, 0.0, 0.1)), 0.03)
    assert TASK.reward(state).item() == pytest.approx(0.2 * (1 - np.tanh(0.5)))


def test_a_lined_up_charger_is_pushed_in_and_a_lifted_one_brought_before_the_holes():
    state = plugged((-0.046, 0.0, 0.0))
    grip(
        state,
        state.objects["charger"].pos[0].numpy() - 0.02 * np.array([np.cos(0.3), np.sin(0.3), 0.0]),
        0.03,
    )
    hand = TASK.commanded(state).pos
    ahead = np.array([np.cos(0.3), np.sin(0.3), 0.0])
    (push,) = TASK.expert(state, np.random.default_rng(0))
    np.testing.assert_allclose(push.pos - hand, 0.046 * ahead, atol=1e-9)
    state = plugged((-0.15, 0.05, 0.02))
    grip(state, state.objects["charger"].pos[0].numpy() - 0.02 * ahead, 0.03)
    _, ready = TASK.expert(state, np.random.default_rng(0))
    left = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    expected = 0.104 * ahead - 0.05 * left - [0.0, 0.0, 0.02]
    np.testing.assert_allclose(ready.pos - TASK.commanded(state).pos, expected, atol=1e-9)
