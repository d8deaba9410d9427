"""Success, reward and observation are functions of tensors, wherever and however precise these are."""

import numpy as np
import pytest
import torch

from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks import TASKS
from envs.tasks.base import Task
from tests.sweeps import sweep

OURS = [name for name in TASKS.names() if "/" not in name]
"""Tasks of a family compute what its library computes, with numpy."""

ALWAYS = {"PickCube", "StackCube", "NutAssembly", "CloseBox", "DrawerOpen", "PegInsertionSide", "Door"}

WITH_ARRAYS = [name for name in OURS if TASKS.get(name).takes_arrays]


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(OURS, ALWAYS))
@pytest.mark.parametrize("function", ["success", "reward", "observe"])
def test_no_constant_stays_on_the_cpu(name, function, states):
    """Meta tensors have no numbers: to look at one, or to mix it with one of the CPU, is an error."""
    task, state = states(name)
    found = getattr(task, function)(state.to("meta", torch.float32))
    assert found.device.type == "meta"
    assert found.shape[0] == state.num_envs


@pytest.mark.parametrize("name", sweep(OURS, ALWAYS))
def test_single_precision_decides_as_double_does(name, states):
    task, state = states(name)
    single = state.to("cpu", torch.float32)
    assert torch.equal(task.success(single), task.success(state))
    np.testing.assert_allclose(task.reward(single), task.reward(state), atol=1e-4)
    np.testing.assert_allclose(task.observe(single), task.observe(state), atol=1e-5)


@pytest.mark.parametrize("name", sweep(WITH_ARRAYS, ALWAYS & set(WITH_ARRAYS)))
def test_arrays_are_judged_as_tensors_are_and_a_row_as_its_batch(name, states):
    task, state = states(name)
    for function in (task.success, task.failure, task.reward, task.observe):
        if function.__func__ is Task.failure:
            continue  # never evaluated
        found = function(state.arrays())
        assert isinstance(found, np.ndarray)
        np.testing.assert_allclose(found, function(state), rtol=1e-14)
        rows = [function(state.select([row]).arrays()) for row in range(state.num_envs)]
        np.testing.assert_array_equal(np.concatenate(rows), found)


@pytest.fixture(scope="module")
def states():
    """Makes a task and two of its initial states, as a simulator completes them; once for each name."""
    known = {}

    def make(name):
        if name not in known:
            task = TASKS.get(name)()
            with MujocoHandler(task.scenario, 2, num_threads=1) as handler:
                handler.launch()
                handler.set_states(task.initial_state([np.random.default_rng(row) for row in range(2)]))
                known[name] = task, handler.get_states()
        return known[name]

    return make
