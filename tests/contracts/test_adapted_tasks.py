"""Short contract test of adapted tasks: each resets, steps, and evaluates its functions."""

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import MissingExtraError
from envs.randomization import channel_rng
from envs.tasks import TASKS
from tests.sweeps import sweep

NUM_ENVS = 2
REPRESENTATIVE = {"metaworld/reach", "metaworld/door-open", "metaworld/pick-place-wall", "metaworld/sweep"}


@pytest.fixture(scope="module", params=sweep(TASKS.names("adapted"), REPRESENTATIVE))
def env(request):
    try:
        TASKS.get(request.param)
    except MissingExtraError as error:
        pytest.skip(str(error))
    env = envs.make_vec(request.param, NUM_ENVS, split="test", observation="state", num_threads=1)
    yield env
    env.close()


@pytest.mark.slow
def test_reset_step_and_queries_work(env):
    task = env.task
    assert task.name in TASKS
    assert task.instructions
    assert env.reset(seed=[3, 4])[0]["environment_state"].std(axis=0).any()
    rng = np.random.default_rng(0)
    for _ in range(5):
        observation, reward, terminated, _, _ = env.step(rng.uniform(-1.0, 1.0, (NUM_ENVS, 4)))
        assert not terminated.any()
        assert ((reward >= 0.0) & (reward < 1.0)).all()
        assert all(np.isfinite(values).all() for values in observation.values())
    state = env.get_states()
    assert task.planner.plan(state.select([1]), rng).shape == (1, 4)
    for entity in state.objects.values():
        entity.pos[:] = torch.nan
    assert not task.success(state).any()


@pytest.mark.slow
def test_initial_states_depend_on_their_generator_alone(env):
    together = env.task.initial_state([channel_rng(0, "task", i) for i in range(3)])
    alone = env.task.initial_state([channel_rng(0, "task", 1)])
    for key, value in alone.flatten().items():
        assert torch.equal(value[0], together.flatten()[key][1]), key
