"""Short contract test of adapted tasks: each resets, steps, and evaluates its functions."""

import numpy as np
import pytest

import envs
from envs.core.errors import MissingExtraError
from envs.tasks import TASKS
from tests.contracts.family_starts import (
    check_it_is_not_solved_by_nan,
    check_starts_follow_from_their_generators,
)
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
    check_it_is_not_solved_by_nan(task, state)


@pytest.mark.slow
def test_initial_states_depend_on_their_generator_alone(env):
    check_starts_follow_from_their_generators(env.task)
