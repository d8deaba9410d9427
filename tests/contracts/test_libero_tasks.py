"""Contract of LIBERO's tasks, where their packages are installed: two always, some of each kind as ``long``.

All 130 are looked at by ``python -m envs.experts.survey``.
"""

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import MissingExtraError
from envs.experts.actor import expert_episodes
from envs.randomization import channel_rng
from envs.tasks import TASKS
from tests.contracts.family_starts import (
    check_it_is_not_solved_by_nan,
    check_it_stays_unsolved,
    check_starts_follow_from_their_generators,
)
from tests.sweeps import sweep

NUM_ENVS = 2
REPRESENTATIVE = {
    "libero/object/pick_up_the_milk_and_place_it_in_the_basket",
    "libero/goal/turn_on_the_stove",
}
"""In and turned on, in two arenas: an object that is carried, and a joint."""

SAMPLE = REPRESENTATIVE | {
    "libero/spatial/pick_up_the_black_bowl_between_the_plate_and_the_ramekin_and_place_it_on_the_plate",
    "libero/10/living_room_scene5_put_the_white_mug_on_the_left_plate_and_put_the_yellow_and_white_mug_on_the_"
    "right_plate",
    "libero/10/study_scene1_pick_up_the_book_and_place_it_in_the_back_compartment_of_the_caddy",
    "libero/90/kitchen_scene4_put_the_wine_bottle_on_the_wine_rack",
}
"""One or more of every suite and arena."""


@pytest.fixture(scope="module", params=sweep(sorted(SAMPLE), REPRESENTATIVE))
def env(request):
    try:
        env = envs.make_vec(request.param, NUM_ENVS, split="test", observation="state", num_threads=1)
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield env
    env.close()


@pytest.mark.slow
def test_it_starts_unsolved_and_stays_where_it_is(env):
    check_it_stays_unsolved(env, env.controller.hold)


@pytest.mark.slow
def test_it_says_what_it_is_and_rewards_less_than_success(env):
    task = env.task
    assert task.name in TASKS and task.instructions == (TASKS.entry(task.name).summary,)
    state = env.get_states()
    reward = task.reward(state)
    assert ((reward >= 0.0) & (reward < 1.0)).all()
    check_it_is_not_solved_by_nan(task, state)


@pytest.mark.slow
def test_initial_states_depend_on_their_generator_alone_and_differ(env):
    check_starts_follow_from_their_generators(env.task)


@pytest.mark.slow
def test_libero_s_fifty_states_are_starts(env):
    task = type(env.task)(starts="libero")
    drawn = task.initial_state([channel_rng(0, "task", i) for i in range(2)])
    assert drawn.num_envs == 2
    first, last = task.fixed_start(0), task.fixed_start(49)
    robot = task.scenario.robots[0].name
    assert not torch.equal(first.robots[robot].joint_pos, last.robots[robot].joint_pos)
    with pytest.raises(envs.core.errors.ConfigError, match="has 50 fixed starts; given index 50"):
        task.fixed_start(50)


@pytest.mark.slow
def test_its_expert_solves_it(request, env):
    if request.node.callspec.params["env"] not in REPRESENTATIVE:
        pytest.skip("python -m envs.experts.survey counts all of them")
    episodes = list(expert_episodes(env, env.split_indices[:NUM_ENVS].tolist()))
    assert all(episode.success for episode in episodes)
    robot = env.scenario.robots[0]
    arm = [index for index, name in enumerate(robot.joint_names) if name not in robot.gripper_joints]
    for episode in episodes:
        assert np.abs(np.diff(episode.actions[:, arm], axis=0)).max() < 0.35
