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
    env.reset_envs(range(NUM_ENVS), env.split_indices[:NUM_ENVS])
    before = env.get_states()
    assert not env.task.success(before).any()
    hold = env.controller.hold(before)
    for _ in range(20):
        assert not env.step_envs(range(NUM_ENVS), hold).success.any()
    after = env.get_states()
    for name, entity in before.objects.items():
        moved = torch.linalg.vector_norm(after.objects[name].pos - entity.pos, dim=-1)
        assert moved.max() < 5e-3, name


@pytest.mark.slow
def test_it_says_what_it_is_and_rewards_less_than_success(env):
    task = env.task
    assert task.name in TASKS and task.instructions == (TASKS.entry(task.name).summary,)
    state = env.get_states()
    reward = task.reward(state)
    assert ((reward >= 0.0) & (reward < 1.0)).all()
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
