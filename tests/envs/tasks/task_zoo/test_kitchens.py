"""Kitchen and MultitaskKitchen: starts and rules, on states made by hand."""

import numpy as np
import pytest
import torch

from envs.tasks.task_zoo import multitask, parts
from envs.tasks.task_zoo.catalogue import entries
from envs.tasks.task_zoo.kitchen import HIDDEN_Z_M, Kitchen
from tests.envs.tasks.table_states import put, starts

GOALS = sorted(entries())


def made(name) -> multitask.MultitaskKitchen:
    return getattr(multitask, name)()


def lever(state, angle):
    state.objects["button"].joint_pos[:] = angle


def touching(state, value=1.0):
    state.objects["bread"].touched[:] = value


def drawer(state, out):
    state.objects["cabinet"].joint_pos[:] = -out


def solved(task, state):
    tensors, arrays = bool(task.success(state)[0]), bool(task.success(state.arrays())[0])
    assert tensors == arrays
    return tensors


def remembered(task, state):
    for name, (pos, rot) in task.memory(state).items():
        state.objects[name].pos, state.objects[name].rot = pos, rot


def serve(task, state):
    put(state, "pot", (*task.layout.region, parts.POT_BOTTOM_M))
    touching(state)


def test_bread_is_served_when_the_stove_has_been_on_and_is_off():
    task = Kitchen()
    state = starts(task)
    serve(task, state)
    assert not solved(task, state)
    lever(state, 0.2)
    remembered(task, state)
    assert not solved(task, state)
    lever(state, -0.2)
    remembered(task, state)
    assert solved(task, state)
    touching(state, 0.0)
    assert not solved(task, state)


@pytest.mark.parametrize(
    ("aside", "served"), [((0.049, 0.099), True), ((0.051, 0.0), False), ((0.0, 0.101), False)]
)
def test_the_region_has_the_zoos_size(aside, served):
    task = Kitchen()
    state = starts(task)
    serve(task, state)
    state.objects["pot"].pos[:, :2] += torch.tensor(aside, dtype=torch.float64)
    assert bool(task.pot_in_region(state)[0]) is served


def test_a_flame_shows_whether_the_stove_is_on():
    task = Kitchen()
    state = starts(task)
    remembered(task, state)
    assert state.objects["flame"].pos[0, 2] == HIDDEN_Z_M
    lever(state, 0.01)
    remembered(task, state)
    assert state.objects["flame"].pos[0, 2] > 0.0


@pytest.mark.parametrize("name", GOALS)
def test_every_condition_of_a_goal_is_needed(name):
    task = made(name)
    entry, state = task.entry, starts(task)
    drawer(state, 0.0)
    lever(state, 0.2 if entry.stove else -0.2)
    touching(state)
    there = (*task.layout.on_stove, 0.02) if entry.place == "stove" else (*task.layout.region, 0.0)
    put(state, "pot", there)
    assert solved(task, state)
    if entry.closes:
        drawer(state, 0.011)
        assert not solved(task, state)
        drawer(state, 0.009)
    if entry.stove is not None:
        lever(state, -0.01 if entry.stove else 0.01)
        assert not solved(task, state)
        lever(state, 0.01 if entry.stove else -0.01)
    touching(state, 0.0)
    assert not solved(task, state)
    touching(state)
    state.objects["pot"].pos[:, 2] += 0.1
    assert not solved(task, state)
    state.objects["pot"].pos[:, 2] -= 0.1
    assert solved(task, state)


@pytest.mark.parametrize("name", GOALS)
def test_nothing_is_inside_another_thing_at_the_start(name):
    task = made(name)
    state, entry = starts(task, 50), task.entry
    pot, reach = state.objects["pot"], np.array([task.pot_reach_m(0.1), task.pot_reach_m(0.0)])
    assert (pot.pos[:, 1] + reach[1] < task.layout.stove[1] - 0.095).all()
    out = -state.objects["cabinet"].joint_pos[:, 0]
    assert (out == (0.1 if entry.starts_open else 0.0)).all()
    assert (pot.pos[:, 1] - reach[1] > -0.185 + out).all()
    assert bool(task.bread_inside(state).all()) is entry.starts_filled
    assert bool((state.objects["button"].joint_pos >= 0.1).all()) is entry.starts_on


def test_instructions_say_what_is_left_to_do():
    said = {name: entry.instructions for name, entry in entries().items()}
    assert said["MultitaskKitchen1"][0] == "close the drawer and push the pot to the serving region"
    assert (
        said["MultitaskKitchen6"][0]
        == "turn on the stove, put the bread in the pot and place the pot on the stove"
    )
