"""The five tasks written as functions of states: by hand, and against Meta-World's own code."""

import numpy as np
import pytest
import torch

pytest.importorskip("metaworld")

from envs.robots.sawyer import SAWYER
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks import TASKS
from envs.tasks.metaworld.furniture import beyond, both, gaussian, long_tail
from envs.tasks.metaworld.original import Original
from envs.tasks.metaworld.scene import GOAL
from envs.tasks.metaworld.task import BELOW_ONE, MetaWorldTask

FIVE = ("DrawerOpen", "DrawerClose", "DoorClose", "WindowOpen", "WindowClose")


@pytest.fixture(scope="module", params=FIVE)
def world(request):
    task = TASKS.get(request.param)()
    with MujocoHandler(task.scenario, 4, num_threads=1) as handler:
        handler.launch()
        yield task, handler


def start(task, handler, seed=0):
    handler.set_states(task.initial_state([np.random.default_rng([seed, row]) for row in range(4)]))
    return handler.get_states()


def at(task, state, joint):
    """The state with the furniture's joint elsewhere."""
    state.objects[task.furniture].joint_pos[:] = joint
    return state


def test_the_shapes_of_the_rewards_by_hand():
    margins = beyond(torch.tensor([0.0, 0.5, 1.0, 2.0]), 0.5, 0.5)
    assert margins.tolist() == [0.0, 0.0, 1.0, 3.0]
    torch.testing.assert_close(long_tail(margins), torch.tensor([1.0, 1.0, 0.1, 1 / 82]))
    torch.testing.assert_close(gaussian(margins), torch.tensor([1.0, 1.0, 0.1, 1e-9]))
    a, b = torch.tensor([0.0, 1.0, 0.5, 1.0]), torch.tensor([0.0, 1.0, 0.5, 0.0])
    torch.testing.assert_close(both(a, b), torch.tensor([0.0, 1.0, 1 / 3, 0.0]))


@pytest.mark.parametrize(
    ("name", "edge", "outwards"),
    [
        ("DrawerOpen", -0.19 + 0.03, 1.0),  # goal at -0.36, handle at -0.17 + joint
        ("WindowOpen", 0.24 - 0.05, -1.0),  # goal at 0.2, handle at -0.04 + joint
        ("WindowClose", -0.01 + 0.05, 1.0),  # goal at 0, handle at 0.01 + joint
    ],
)
def test_success_begins_where_meta_world_says(name, edge, outwards):
    task = TASKS.get(name)()
    with MujocoHandler(task.scenario, 4, num_threads=1) as handler:
        handler.launch()
        state = start(task, handler)
    assert task.success(at(task, state, edge - outwards * 1e-6)).all()
    assert not task.success(at(task, state, edge + outwards * 1e-6)).any()


@pytest.mark.slow
def test_start_is_no_success_and_the_goal_has_a_higher_reward(world):
    task, handler = world
    state = start(task, handler)
    before = task.reward(state)
    assert not task.success(state).any()
    solved = {"DrawerOpen": -0.16, "WindowOpen": 0.2}
    state = at(task, state, solved.get(task.name, 0.0))
    assert task.success(state).all()
    assert (task.reward(state) > before).all()
    assert (task.reward(state) <= BELOW_ONE).all()
    state.objects[task.furniture].joint_pos[:] = torch.nan
    assert not task.success(state).any()


def test_the_fingertips_and_the_gripper_by_hand(world):
    """The hand points down: its x axis is -z of the world, its y axis y."""
    task, handler = world
    state = start(task, handler)
    robot = state.robots[SAWYER.name]
    robot.ee_pos[:] = torch.tensor([0.1, 0.6, 0.3])
    robot.ee_rot[:] = torch.tensor([0.5**0.5, 0.0, 0.5**0.5, 0.0])
    robot.joint_pos[:, -2:] = torch.tensor([0.03, -0.01])
    torch.testing.assert_close(task.tcp(state), torch.tensor([[0.1, 0.61, 0.255]] * 4, dtype=torch.float64))
    seen = task.observe(state)
    torch.testing.assert_close(seen[:, :3], robot.ee_pos)
    torch.testing.assert_close(seen[:, 3], torch.full((4,), 0.6, dtype=torch.float64))
    assert torch.equal(seen[:, 18:], state.objects[GOAL].pos)
    robot.ee_pos[:] = 2.0
    assert task.observe(state)[0, :3].tolist() == [0.525, 1.025, 0.7]


@pytest.mark.slow
def test_states_of_all_kinds_are_judged_as_by_meta_world(world):
    task, handler = world
    state, rng = start(task, handler, seed=1), np.random.default_rng(0)
    solved = 0
    for step in range(100):
        seen, rewards, successes = MetaWorldTask._answers(task, state)
        np.testing.assert_allclose(task.observe(state), seen, atol=1e-9)
        np.testing.assert_array_equal(task.success(state), successes)
        theirs = np.clip(rewards / 10.0, 0.0, BELOW_ONE)[~successes]
        if task.name != "DrawerClose":
            np.testing.assert_allclose(task.reward(state)[~successes], theirs, atol=1e-6)
        actions = np.concatenate([task.planner.plan(state.select([row]), rng) for row in range(4)])
        if step % 2:
            actions[2:] = rng.uniform(-1.0, 1.0, (2, 4))
        task.controller.apply(handler, actions)
        handler.step(5)
        state = handler.get_states()
        solved += int(successes.sum())
    assert solved > 0


def parity(task, handler, episodes):
    """Plays Meta-World and ours side by side, with the actions of Meta-World's policy for Meta-World.

    Returns the numbers of successes and of steps that disagree about it, and the largest difference of an
    observation.
    """
    theirs = Original(task.original_name)
    solved, disagreed, error = np.zeros(2, int), 0, 0.0
    for episode in range(episodes):
        handler.set_states(task.initial_state([np.random.default_rng([2, episode])] * 1), [0])
        state = handler.get_states([0])
        vector = task.scene.poses(state)[1][0]
        theirs.env._freeze_rand_vec, theirs.env._last_rand_vec = True, vector
        observation, _ = theirs.env.reset()
        over = np.zeros(2, bool)
        for _ in range(task.max_episode_steps):
            action = theirs.action(observation)
            observation, _, _, _, info = theirs.env.step(action)
            task.controller.apply(handler, action[None], [0])
            handler.step(5, [0])
            state = handler.get_states([0])
            success = bool(task.success(state)[0])
            disagreed += success != bool(info["success"])
            over |= (bool(info["success"]), success)
            seen = np.concatenate([observation[:18], observation[36:]])
            error = max(error, float(np.abs(task.observe(state)[0].numpy() - seen).max()))
            if over.all():
                break
        solved += over
    return solved, disagreed, error


@pytest.mark.slow
def test_an_episode_is_meta_worlds(world):
    solved, disagreed, error = parity(*world, episodes=1)
    assert solved.tolist() == [1, 1]
    assert disagreed == 0
    assert error < 1e-8


@pytest.mark.long
def test_fifty_episodes_are_meta_worlds(world):
    solved, disagreed, error = parity(*world, episodes=50)
    assert (solved >= 49).all()
    assert disagreed == 0
    assert error < 1e-3  # contacts: two solvers' last bits, after 80 steps
