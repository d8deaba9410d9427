"""HammerPlace and ToolUse: starts and rules, on states made by hand."""

import pytest
import torch

from envs.tasks.task_zoo.hammer_place import HammerPlace
from envs.tasks.task_zoo.tool_use import POT_M, ToolUse
from tests.envs.tasks.table_states import put, starts


def solved(task, state):
    tensors, arrays = bool(task.success(state)[0]), bool(task.success(state.arrays())[0])
    assert tensors == arrays
    return tensors


@pytest.mark.parametrize(
    ("out", "place", "done"),
    [
        (0.009, (0.0, 0.25, 0.06), True),
        (0.011, (0.0, 0.25, 0.06), False),
        (0.0, (0.0, 0.215, 0.06), False),
        (0.0, (0.0, 0.25, 0.035), False),
        (0.0, (0.0, 0.25, 0.105), False),
    ],
)
def test_a_hammer_is_stored_in_a_shut_drawer(out, place, done):
    task = HammerPlace()
    state = starts(task)
    put(state, "hammer", place)
    state.objects["cabinet"].joint_pos[:] = -out
    assert solved(task, state) is done


def test_a_hammer_lies_on_either_side_before_the_shut_drawer():
    state = starts(HammerPlace(), 200)
    hammer, cabinet = state.objects["hammer"], state.objects["cabinet"]
    assert (cabinet.joint_pos == 0.0).all()
    assert ((hammer.pos[:, 0] >= -0.1) & (hammer.pos[:, 0] <= -0.02)).all()
    assert ((hammer.pos[:, 1] >= -0.2) & (hammer.pos[:, 1] <= -0.13)).all()
    assert 60 < int((hammer.rot[:, 0] > 0.0).sum()) < 140


@pytest.mark.parametrize(
    ("off", "touches", "done"),
    [((0.0, 0.0, 0.02), 1.0, True), ((0.061, 0.0, 0.02), 1.0, False), ((0.0, 0.0, 0.06), 1.0, False),
     ((0.0, 0.0, 0.02), 0.0, False)],
)  # fmt: skip
def test_a_cube_is_in_the_pot_that_it_touches(off, touches, done):
    task = ToolUse()
    state = starts(task)
    put(state, "cube", tuple(a + b for a, b in zip((*POT_M, 0.0025), off, strict=True)))
    state.objects["cube"].touched[:] = touches
    assert solved(task, state) is done


def test_cube_and_tool_start_where_the_zoos_widest_variant_has_them():
    state = starts(ToolUse(), 500)
    cube, tool = state.objects["cube"].pos, state.objects["tool"].pos
    low = torch.tensor([0.09, -0.25, 0.02, -0.14, -0.23], dtype=torch.float64)
    high = torch.tensor([0.12, -0.10, 0.02, -0.12, -0.03], dtype=torch.float64)
    seen = torch.cat([cube, tool[:, :2]], -1)
    assert torch.allclose(seen.amin(0), low, atol=2e-3) and torch.allclose(seen.amax(0), high, atol=2e-3)
