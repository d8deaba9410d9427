"""What a task remembers of an episode is in markers, which move after every step."""

import pytest
import torch

from envs.array_ops import stack
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube

STEP_M = 0.01

pytestmark = pytest.mark.slow


@pytest.fixture
def rising(monkeypatch):
    """PickCube whose goal rises by a centimetre in every step."""

    def memory(self, state):
        goal = state.objects["goal"]
        x, y, z = goal.pos.T
        return {"goal": (stack((x, y, z + STEP_M)).T, goal.rot)}

    monkeypatch.setattr(PickCube, "memory", memory)


def goals(env):
    return torch.as_tensor(env.get_states().objects["goal"].pos)


def test_markers_move_in_the_environments_that_step(rising):
    env = EnvSpec(task="PickCube").make(3, observation="state")
    env.reset(seed=0)
    start = goals(env)
    action = env.controller.hold(env.get_states())
    env.step(action)
    env.step_envs([2], action[2:])
    risen = goals(env) - start
    assert risen[:, :2].abs().max() == 0.0
    assert risen[:, 2].tolist() == pytest.approx([STEP_M, STEP_M, 2 * STEP_M])
    env.close()


def test_a_step_is_judged_by_what_it_led_to(rising, monkeypatch):
    env = EnvSpec(task="PickCube").make(2, observation="state")
    env.reset(seed=0)
    start, seen = goals(env), []
    monkeypatch.setattr(
        PickCube, "failure", lambda self, state: seen.append(state) or state.objects["goal"].pos[:, 2] < 0
    )
    env.step(env.controller.hold(env.get_states()))
    assert torch.as_tensor(seen[0].objects["goal"].pos)[:, 2].tolist() == pytest.approx(
        (start[:, 2] + STEP_M).tolist()
    )
    env.close()


@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_markers_move_with_tensors_and_start_again(rising, simulator):
    env = EnvSpec(task="PickCube", simulator=simulator).make_torch(
        2, bank_size=1, num_threads=1, max_episode_steps=2
    )
    env.reset()
    start = goals(env)
    env.step(torch.zeros(2, env.action_size))
    assert (goals(env) - start)[:, 2].tolist() == pytest.approx([STEP_M] * 2, abs=1e-6)
    env.step(torch.zeros(2, env.action_size))
    assert torch.allclose(goals(env), start, atol=1e-6)
    env.close()
