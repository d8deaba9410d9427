"""Threading, ThreePieceAssembly, Coffee and MugCleanup: starts and rules, on states made by hand."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.rotations import from_euler
from envs.tasks.assembly import coffee, mug_cleanup, threading, three_pieces
from envs.tasks.assembly.coffee import Coffee
from envs.tasks.assembly.mug_cleanup import MugCleanup
from envs.tasks.assembly.threading import Threading
from envs.tasks.assembly.three_pieces import ThreePieceAssembly
from tests.envs.tasks.table_states import grip, put, starts

FAMILY = (Threading, ThreePieceAssembly, Coffee, MugCleanup)
EVERY = [(cls, name) for cls in FAMILY for name in cls.ranges]


def solved(task, state):
    tensors, arrays = bool(task.success(state)[0]), bool(task.success(state.arrays())[0])
    assert tensors == arrays
    return tensors


@pytest.mark.parametrize(("cls", "name"), EVERY)
def test_objects_fill_their_ranges_and_keep_apart(cls, name):
    task = cls(start_range=name)
    state = starts(task, 300)
    assert not task.success(state).any()
    for item, one in task.ranges[name].items():
        pos = state.objects[item].pos
        for column, (low, high) in enumerate((one.x_m, one.y_m)):
            seen = pos[:, column]
            assert low <= seen.min() <= low + 0.1 * (high - low) + 1e-9
            assert high >= seen.max() >= high - 0.1 * (high - low) - 1e-9
    names = list(task.ranges[name])
    for index, a in enumerate(names):
        for b in names[:index]:
            apart = (state.objects[a].pos - state.objects[b].pos)[:, :2].norm(dim=-1)
            assert (apart > task.radii_m[a] + task.radii_m[b]).all()


def test_an_unknown_range_is_named():
    with pytest.raises(UnknownNameError, match=r"Unknown start_range of Coffee 'D3'.*D0.*D1.*D2"):
        Coffee(start_range="D3")
    with pytest.raises(ConfigError, match=r"task_kwargs\.qpos_noise_rad is a number of at least 0"):
        Coffee(qpos_noise_rad=-1.0)


def test_a_needle_is_threaded_within_the_rings_radius():
    task = Threading()
    state = starts(task)
    ring = task.ring(state)[0]
    assert ring.tolist() == pytest.approx([0.0, -0.15, threading.RING_Z_M])
    for off, done in ((0.017, True), (0.019, False)):
        put(state, "needle", (ring + torch.tensor([0.0, 0.0, off])).tolist(), np.pi)
        assert solved(task, state) is done


def test_pieces_are_assembled_when_both_are_let_go_of():
    task = ThreePieceAssembly()
    state = starts(task)
    put(state, "piece_1", (0.0, 0.0, three_pieces.ABOVE_M[0]))
    assert not solved(task, state)
    put(state, "piece_2", (0.0, 0.0, three_pieces.ABOVE_M[1]))
    assert solved(task, state)
    for name, index in (("piece_1", 0), ("piece_2", 1)):
        place = state.objects[name].pos[0].tolist()
        held = (place[0], place[1], place[2] + three_pieces.GRIP_M[index])
        grip(state, held, three_pieces.WIDTH_M[index])
        assert not solved(task, state)
    grip(state, (0.0, 0.0, 0.4), 0.08)
    assert solved(task, state)
    put(state, "piece_2", (0.021, 0.0, three_pieces.ABOVE_M[1]))
    assert not solved(task, state)
    put(state, "piece_2", (0.0, 0.0, three_pieces.ABOVE_M[1] + 0.021))
    assert not solved(task, state)


def test_coffee_needs_the_pod_in_the_holder_and_the_lid_shut():
    task = Coffee()
    state = starts(task)
    x, y, z = task.holder(state)[0].tolist()
    inside = z - coffee.HOLDER_HALF_M + coffee.POD_HALF_M + 0.004
    put(state, "pod", (x, y, inside))
    assert bool(task.pod_inside(state)[0]) and not solved(task, state)
    state.objects["machine"].joint_pos[:] = np.radians(14.0)
    assert solved(task, state)
    for place in ((x + 0.0101, y, inside), (x, y, inside + 0.02), (x, y, inside - 0.01)):
        put(state, "pod", place)
        assert not solved(task, state)
    put(state, "pod", (x, y, inside))
    state.objects["machine"].joint_pos[:] = np.radians(16.0)
    assert not solved(task, state)


def test_a_mug_stands_in_the_shut_drawer():
    task = MugCleanup()
    state = starts(task)
    chest, item = state.objects["cabinet"], state.objects["mug"]
    height = chest.pos[0, 2].item() + mug_cleanup.FLOOR_M + mug_cleanup.HEIGHT_M / 2
    put(state, "mug", (0.0, 0.28, height))
    item.touched[:] = 1.0
    assert solved(task, state)
    chest.joint_pos[:] = -0.02
    assert not solved(task, state)
    chest.joint_pos[:] = 0.0
    item.touched[:] = 0.0
    assert not solved(task, state)
    item.touched[:] = 1.0
    item.rot = torch.from_numpy(from_euler(np.array([[0.0, 0.05, 0.0]])))
    assert not solved(task, state)
    item.rot = torch.from_numpy(from_euler(np.array([[0.5, 0.03, 0.0]])))
    assert solved(task, state)
    put(state, "mug", (0.0, 0.1, height))
    assert not solved(task, state)
