"""Wipe: the line of dirt, what the wiper takes off it, and when the table is clean."""

import numpy as np
import pytest
import torch

from envs.tasks.robosuite.wipe import GAP_M, MARKERS, SHOWN_Z_M, WIPED_Z_M, WIPER_M, Wipe
from tests.envs.tasks.table_states import vector

DOWN = vector(0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0)
"""The wiper points down, its longer side along x."""


def started(count=1):
    task = Wipe()
    state = task.initial_state([np.random.default_rng(row) for row in range(count)])
    robot = state.robots["franka_wiper"]
    robot.ee_pos, robot.ee_rot = vector(0.0, 0.0, 0.3).repeat(count, 1), DOWN.repeat(count, 1)
    return task, state


def remembered(task, state):
    moved = task.memory(state)
    in_arrays = task.memory(state.arrays())
    assert moved.keys() == in_arrays.keys()
    for name, (pos, rot) in moved.items():
        assert np.allclose(pos, in_arrays[name][0])
        state.objects[name].pos, state.objects[name].rot = pos, rot
    return moved


def test_dirt_is_a_line_within_the_covered_part_of_the_table():
    task, state = started(40)
    places = task.dirt(state)
    steps = (places[:, 1:] - places[:, :-1]).norm(dim=-1)
    assert torch.allclose(steps, torch.full_like(steps, 0.005))
    most = torch.tensor([0.25, 0.4], dtype=torch.float64) * 0.6 - 0.02
    off = (places[..., :2] - torch.tensor([0.15, 0.0], dtype=torch.float64)).abs()
    assert (off <= most + 1e-9).all() and (off.amax((0, 1)) > 0.95 * most).all()


@pytest.mark.parametrize(
    ("aside", "height", "wiped"),
    [
        ((0.0, 0.0), 0.0, True),
        ((0.0, 0.0), GAP_M - 1e-4, True),
        ((0.0, 0.0), GAP_M + 1e-4, False),
        ((0.0, 0.0), -0.019, True),
        ((0.0, 0.0), -0.021, False),
        ((WIPER_M[1] - 1e-3, 0.0), 0.0, True),
        ((WIPER_M[1] + 1e-3, 0.0), 0.0, False),
        ((0.0, WIPER_M[0] - 1e-3), 0.0, True),
        ((0.0, WIPER_M[0] + 1e-3), 0.0, False),
    ],
)
def test_the_wiper_takes_what_is_under_it(aside, height, wiped):
    task, state = started()
    x, y, _ = state.objects[MARKERS[0]].pos[0].tolist()
    state.robots["franka_wiper"].ee_pos = vector(x + aside[0], y + aside[1], height)
    assert (MARKERS[0] in remembered(task, state)) is wiped
    assert state.objects[MARKERS[0]].pos[0, 2].item() == (WIPED_Z_M if wiped else SHOWN_Z_M)


def test_the_table_is_clean_when_all_dirt_was_wiped():
    task, state = started()
    for name in MARKERS:
        assert bool(task.success(state)[0]) is not bool(task.left(state).any())
        pos = state.objects[name].pos[0]
        state.robots["franka_wiper"].ee_pos = vector(pos[0].item(), pos[1].item(), 0.0)
        remembered(task, state)
    assert task.success(state).all() and task.success(state.arrays()).all()
    assert not remembered(task, state)
    assert task.observe(state)[0, 0] == 1.0


def test_each_environment_remembers_its_own_dirt():
    task, state = started(2)
    pos = state.objects[MARKERS[50]].pos
    state.robots["franka_wiper"].ee_pos[1] = torch.tensor([pos[1, 0], pos[1, 1], 0.0])
    remembered(task, state)
    left = task.left(state)
    assert left[0].all() and not left[1, 50]


def test_the_expert_stays_when_nothing_is_left():
    """The last step of a plan may wipe the last marker, before the next plan is asked for."""
    task, state = started()
    for name in MARKERS:
        state.objects[name].pos[:, 2] = WIPED_Z_M
    (way,) = task.expert(state, np.random.default_rng(0))
    assert np.allclose(way.pos, [0.0, 0.0, 0.3])
