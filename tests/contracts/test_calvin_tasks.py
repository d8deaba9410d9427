"""Contract of CALVIN's tasks: four always, some of each kind and scene as ``long``.

All are looked at by ``python -m envs.experts.survey``.
"""

import numpy as np
import pytest

import envs
from envs.experts.actor import expert_episodes
from envs.tasks import TASKS
from tests.contracts.family_starts import (
    check_it_is_not_solved_by_nan,
    check_it_stays_unsolved,
    check_starts_follow_from_their_generators,
)
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
    # A target, and not a position: a block stays in the hand.
    check_it_stays_unsolved(env, lambda start: start.robots[env.task.robot.name].joint_target.numpy())


@pytest.mark.slow
def test_it_says_what_it_is_and_a_state_that_is_not_finite_is_no_success(env):
    task = env.task
    assert task.name in TASKS and task.instructions == (TASKS.entry(task.name).summary,)
    state = env.get_states()
    check_it_is_not_solved_by_nan(task, state)


@pytest.mark.slow
def test_initial_states_depend_on_their_generator_alone_and_differ(env):
    check_starts_follow_from_their_generators(env.task)


@pytest.mark.slow
def test_its_expert_solves_it_smoothly(env):
    episodes = list(expert_episodes(env, env.split_indices[:NUM_ENVS].tolist()))
    assert all(episode.success for episode in episodes)
    robot = env.scenario.robots[0]
    arm = [index for index, name in enumerate(robot.joint_names) if name not in robot.gripper_joints]
    for episode in episodes:
        assert np.abs(np.diff(episode.actions[:, arm], axis=0)).max() < 0.35
