"""Contract of tasks for reinforcement learning, in both MuJoCos."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, MissingExtraError
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks import TASKS
from tests.robot_files import needs_files_of_task

LEARNED_BY_REWARD = (
    "PickCube",
    "StackCube",
    "PushCube",
    "Stack",
    "DrawerOpen",
    "DrawerClose",
    "DoorClose",
    "WindowOpen",
    "WindowClose",
    "control/cartpole",
    "control/ant",
    "control/franka_reach",
    "humanoid/stand",
    "humanoid/walk",
    "humanoid/run",
    "humanoid/h1hand_walk",
)

NUM_ENVS, STEPS = 2, 3


ALWAYS = {
    *(
        ("PickCube", "mujoco"),
        ("DrawerOpen", "mujoco"),
        ("control/ant", "mujoco"),
        ("humanoid/walk", "mujoco"),
    ),
    *(("PickCube", "mujoco_warp"), ("control/ant", "mujoco_warp")),
}

PAIRS = [
    pytest.param(
        name,
        simulator,
        marks=() if (name, simulator) in ALWAYS else pytest.mark.long,
    )
    for simulator in ("mujoco", "mujoco_warp")
    for name in LEARNED_BY_REWARD
]


def made(name, simulator):
    needs_files_of_task(name)
    try:
        return EnvSpec(task=name, simulator=simulator).make_torch(
            NUM_ENVS,
            num_threads=1,
            bank_size=NUM_ENVS,
            max_episode_steps=STEPS,
            shift_reward=False,
        )
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "simulator"), PAIRS)
def test_agent_steps_and_gets_reward(name, simulator):
    """Observations are finite; rewards differ, and stay below 1 where success ends an episode."""
    env, rewards = made(name, simulator), []
    torch.manual_seed(0)
    for index in range(STEPS):
        step = env.step(2.0 * torch.rand(NUM_ENVS, env.action_size) - 1.0)
        rewards.append(step.reward)
        assert torch.isfinite(step.obs).all() and torch.isfinite(step.reward).all()
        assert step.truncated.all() == (index == STEPS - 1)
        assert not step.terminated.any() and not step.success.any()
    rewards = torch.stack(rewards)
    assert len(rewards.unique()) > STEPS
    if env.task.ends_on_success:
        assert (rewards >= 0.0).all() and (rewards < 1.0).all()
    env.close()


def test_tasks_without_an_expert_are_tagged_rl():
    names = [name for name in TASKS if {"humanoid", "control"} & set(TASKS.entry(name).tags)]
    assert len(names) == 19
    assert set(names) == set(TASKS.names("rl"))
    for name in names:
        task = TASKS.get(name)()
        assert not task.has_expert
        with pytest.raises(ConfigError, match=f"{name} has no scripted expert. Use reinforcement"):
            task.expert(State({}, {}), np.random.default_rng(0))
