import contextlib

import pytest

import envs


@pytest.fixture(scope="session")
def pick_env():
    """Two PickCube environments without images."""
    with contextlib.closing(envs.make_vec("PickCube", 2, split="train", observation="state")) as env:
        yield env


@pytest.fixture(scope="session")
def lift_env():
    """Two environments of PickCube's other variant, without images."""
    kwargs = {"variant": "lift"}
    env = envs.make_vec("PickCube", 2, split="train", observation="state", task_kwargs=kwargs)
    with contextlib.closing(env):
        yield env


@pytest.fixture(scope="session")
def played(pick_env):
    """Two episodes of the expert of PickCube."""
    from envs.experts.actor import expert_episodes

    return list(expert_episodes(pick_env, pick_env.split_indices[100:102].tolist()))


@pytest.fixture(scope="session")
def lifted(lift_env):
    """Two episodes of the expert of its other variant."""
    from envs.experts.actor import expert_episodes

    return list(expert_episodes(lift_env, lift_env.split_indices[100:102].tolist()))
