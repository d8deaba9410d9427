"""What every registered task promises, on its default simulator.

The 45 tasks tagged ``adapted`` share one class, and so do LIBERO's 130: ``test_adapted_tasks.py`` and
``test_libero_tasks.py`` look at them more briefly.
"""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import envs
from envs.core.errors import MissingExtraError
from envs.experts.actor import expert_episodes
from envs.gym_registration import gym_id
from envs.randomization import channel_rng
from envs.state import State
from envs.tasks import TASKS
from tests.sweeps import sweep

NUM_ENVS = 3


NAMES = [name for name in TASKS if not {"adapted", "libero"} & TASKS.entry(name).tags]
REPRESENTATIVE = {
    *("PickCube", "StackCube", "CloseBox", "DrawerOpen"),
    *("control/ant", "control/cartpole", "control/franka_reach", "humanoid/walk", "humanoid/maze"),
}
"""A free object, two of them, a joint of ours and one of Meta-World; every robot that acts by itself."""


@pytest.fixture(scope="module", params=sweep(NAMES, REPRESENTATIVE))
def env(request):
    try:
        env = envs.make_vec(request.param, NUM_ENVS, split="test", observation="state")
    except MissingExtraError as error:
        pytest.skip(str(error))
    yield env
    env.close()


@pytest.fixture(scope="module")
def rollouts(env):
    if not env.task.has_expert:
        pytest.skip(f"{env.task.name} has no expert")
    return list(expert_episodes(env, env.split_indices[: 2 * NUM_ENVS].tolist()))


@pytest.mark.slow
def test_it_says_what_it_is(env):
    task = env.task
    assert task.name in TASKS
    assert task.instructions
    assert all(text == text.strip() and text for text in task.instructions)
    assert task.max_episode_steps > 1
    assert TASKS.entry(task.name).summary


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*symmetric and normalized space:UserWarning")
def test_gymnasium_accepts_the_single_env(env):
    single = gymnasium.make(gym_id(env.task.name), observation="state")
    check_env(single.unwrapped, skip_render_check=True)
    single.close()


@pytest.mark.slow
def test_equal_seeds_give_bit_identical_episodes(env):
    def run():
        observations = [env.reset(seed=[5, 6, 7])[0]]
        rng = np.random.default_rng(0)
        low, high = env.single_action_space.low, env.single_action_space.high
        for _ in range(5):
            actions = rng.uniform(low, high, (NUM_ENVS, len(low))).astype(np.float32)
            observations.append(env.step(actions)[0])
        return observations

    for first, second in zip(run(), run(), strict=True):
        for key in first:
            np.testing.assert_array_equal(first[key], second[key])


@pytest.mark.slow
def test_resets_differ_and_nothing_observed_is_constant(env):
    rows = []
    for first in range(0, 30, NUM_ENVS):
        env.reset_envs(range(NUM_ENVS), env.split_indices[first : first + NUM_ENVS])
        rows.append(env.observe()["observation.environment_state"])
    values = np.concatenate(rows)
    moving = values.std(axis=0) > 1e-6
    # Heights, orientations and velocities may start out equal; positions may not. Meta-World starts with the
    # hand in one place, and fills its observation up with zeros.
    assert moving.any() if "metaworld" in TASKS.entry(env.task.name).tags else moving.mean() > 0.4
    assert len(np.unique(values, axis=0)) == len(values)


def test_observations_are_finite_and_their_own(env):
    env.reset(seed=0)
    first = env.observe()
    copies = {key: value.copy() for key, value in first.items()}
    env.step(np.stack([env.single_action_space.sample() for _ in range(NUM_ENVS)]))
    assert set(first.pop("task")) <= set(env.task.instructions)
    for key, value in first.items():
        assert np.isfinite(value).all()
        np.testing.assert_array_equal(value, copies[key])


def test_initial_states_depend_on_their_generator_alone(env):
    together = env.task.initial_state([channel_rng(0, "task", i) for i in range(4)])
    alone = env.task.initial_state([channel_rng(0, "task", 2)])
    for key, value in alone.flatten().items():
        assert torch.equal(value[0], together.flatten()[key][2]), key


@pytest.mark.slow
def test_the_expert_succeeds(rollouts):
    assert all(rollout.success for rollout in rollouts)


def test_the_expert_is_smooth(env, rollouts):
    """Neither the arm's joints nor their targets jump: below 0.35 rad in one control step, 7 rad/s."""
    robot = env.scenario.robots[0]
    arm = [index for index, name in enumerate(robot.joint_names) if name not in robot.gripper_joints]
    for rollout in rollouts:
        assert np.abs(np.diff(rollout.observation_state[:, arm], axis=0)).max() < 0.35
        if env.controller.names == robot.joint_names:
            assert np.abs(np.diff(rollout.actions[:, arm], axis=0)).max() < 0.35


def test_the_expert_varies(env, rollouts):
    assert len({len(rollout.actions) for rollout in rollouts}) > 1


def test_reward_rises_towards_success(rollouts):
    """The reward drops by less than 0.2: robosuite's reward drops while a nut is lowered onto its peg."""
    for rollout in rollouts:
        solved = int(np.argmax(rollout.rewards == 1.0))
        assert rollout.rewards[solved] == 1.0
        assert (rollout.rewards[:solved] < 1.0).all()
        assert (rollout.rewards >= 0.0).all()
        assert rollout.rewards[0] < rollout.rewards[solved - 1]
        way = rollout.rewards[: solved + 1]
        lost = np.maximum.accumulate(way) - way
        assert lost.max() < 0.2, "the expert's way is no way up"
        assert way[: len(way) // 4].mean() < way[-(len(way) // 4) :].mean()


@pytest.mark.slow
def test_random_actions_do_not_succeed(env):
    rng = np.random.default_rng(1)
    env.reset_envs(range(NUM_ENVS), env.split_indices[:NUM_ENVS])
    low, high = env.single_action_space.low, env.single_action_space.high
    solved, over = np.zeros(NUM_ENVS, bool), np.zeros(NUM_ENVS, bool)
    for _ in range(env.task.max_episode_steps // 4):
        step = env.step_envs(range(NUM_ENVS), rng.uniform(low, high, (NUM_ENVS, len(low))))
        solved |= step.success & ~over
        over |= step.terminated | step.truncated
        if over.all():  # such as those of a robot that has fallen
            break
    # An arm that beats about knocks a lid shut now and then: a quarter of CloseBox's whole episodes.
    assert solved.mean() <= 0.5


def test_states_that_are_not_finite_are_no_success(env):
    flat = env.get_states().flatten()
    state = State.unflatten({key: torch.full_like(value, torch.nan) for key, value in flat.items()})
    assert not env.task.success(state).any()


@pytest.mark.slow
def test_scene_at_rest_stays_at_rest(env):
    """Objects keep still for 10 s while the robot holds its posture: no sliding, sinking or flying."""
    if not env.scenario.robots[0].fixed_base:
        pytest.skip("a robot that falls may move things")
    env.reset_envs(range(NUM_ENVS), env.split_indices[:NUM_ENVS])
    before = env.get_states()
    hold = env.controller.hold(before)
    for _ in range(round(10 * env.control_hz)):
        env.step_envs(range(NUM_ENVS), hold)
    after = env.get_states()
    for name, entity in before.objects.items():
        moved = torch.linalg.vector_norm(after.objects[name].pos - entity.pos, dim=-1)
        assert moved.max() < 2e-3, name
