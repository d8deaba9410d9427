"""Contract of CALVIN's tasks: four always, some of each kind and scene as ``long``.

All are looked at by ``python -m envs.experts.survey``.
"""

import numpy as np
import pytest
import torch

import envs
from envs.experts.actor import expert_episodes
from envs.randomization import channel_rng
from envs.tasks import TASKS
from tests.sweeps import sweep

NUM_ENVS = 2
REPRESENTATIVE = {"calvin/D/open_drawer", "calvin/D/lift_red_block_slider", "calvin/D/stack_block"}
SAMPLE = REPRESENTATIVE | {
    "calvin/A/open_drawer",
    "calvin/B/move_slider_right",
    "calvin/C/turn_on_lightbulb",
    "calvin/D/place_in_drawer",
    "calvin/D/push_into_drawer",
    "calvin/D/unstack_block",
}


@pytest.fixture(scope="module", params=sweep(sorted(SAMPLE), REPRESENTATIVE))
def env(request):
    env = envs.make_vec(request.param, NUM_ENVS, split="test", observation="state", num_threads=1)
    yield env
    env.close()


@pytest.mark.slow
def test_it_starts_unsolved_and_what_lies_stays_where_it_is(env):
    env.reset_envs(range(NUM_ENVS), env.split_indices[:NUM_ENVS])
    before = env.get_states()
    assert not env.task.success(before).any()
    hold = before.robots[env.task.robot.name].joint_target.numpy()  # a block stays in the hand
    for _ in range(20):
        assert not env.step_envs(range(NUM_ENVS), hold).success.any()
    after = env.get_states()
    for name, entity in before.objects.items():
        moved = torch.linalg.vector_norm(after.objects[name].pos - entity.pos, dim=-1)
        assert moved.max() < 5e-3, name


@pytest.mark.slow
def test_it_says_what_it_is_and_a_state_that_is_not_finite_is_no_success(env):
    task = env.task
    assert task.name in TASKS and task.instructions == (TASKS.entry(task.name).summary,)
    state = env.get_states()
    for entity in state.objects.values():
        entity.pos[:] = torch.nan
    assert not task.success(state).any()


@pytest.mark.slow
def test_initial_states_depend_on_their_generator_alone_and_differ(env):
    together = env.task.initial_state([channel_rng(0, "task", i) for i in range(3)])
    alone = env.task.initial_state([channel_rng(0, "task", 1)])
    for key, value in alone.flatten().items():
        assert torch.equal(value[0], together.flatten()[key][1]), key
    flat = torch.cat([value.flatten(1) for value in together.flatten().values()], dim=1)
    assert len(torch.unique(flat, dim=0)) == 3


@pytest.mark.slow
def test_its_expert_solves_it_smoothly(env):
    episodes = list(expert_episodes(env, env.split_indices[:NUM_ENVS].tolist()))
    assert all(episode.success for episode in episodes)
    robot = env.scenario.robots[0]
    arm = [index for index, name in enumerate(robot.joint_names) if name not in robot.gripper_joints]
    for episode in episodes:
        assert np.abs(np.diff(episode.actions[:, arm], axis=0)).max() < 0.35
