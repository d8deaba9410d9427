"""Banks of start states: states on the expert's path."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.simulators.mujoco.handler import MujocoHandler
from envs.spec import EnvSpec
from envs.start_states import expert_states
from envs.tasks.pick_cube import PickCube

pytestmark = pytest.mark.slow

N, NUM_STATES = 4, 20


@pytest.fixture(scope="module")
def kept():
    task = PickCube()
    with MujocoHandler(task.scenario, N, num_threads=1) as handler:
        handler.launch()
        initial = task.initial_state([np.random.default_rng(row) for row in range(N)])
        rngs = [np.random.default_rng(100 + row) for row in range(N)]
        found = expert_states(task, handler, initial, rngs, substeps=25, num_states=NUM_STATES)
    return task, initial, found


def test_states_cover_the_expert_path_and_none_is_solved(kept):
    task, _, found = kept
    assert 0.1 * N * NUM_STATES < found.num_envs < N * NUM_STATES
    height = found.objects["cube"].pos[:, 2]
    assert (height < 0.03).any() and (height > 0.05).any()
    robot = found.robots["franka"]
    gap = robot.joint_pos[:, 7] + robot.joint_pos[:, 8]
    assert (gap > 0.07).any() and (gap < 0.05).any()
    assert not task.success(found).any()


def test_same_generators_give_same_states(kept):
    task, initial, found = kept
    with MujocoHandler(task.scenario, N, num_threads=1) as handler:
        handler.launch()
        rngs = [np.random.default_rng(100 + row) for row in range(N)]
        again = expert_states(task, handler, initial, rngs, substeps=25, num_states=NUM_STATES)
    for key, value in found.flatten().items():
        assert torch.equal(value, again.flatten()[key]), key


def test_share_of_episodes_starts_on_expert_path():
    env = EnvSpec().make_torch(
        8, num_threads=1, bank_size=8, substeps=5, expert_starts=0.5, max_episode_steps=1
    )
    begun = [env.handler.get_states().objects["cube"].pos[:, 2].clone()]
    for _ in range(12):  # each step ends every episode
        env.step(torch.zeros(8, 5))
        begun.append(env.handler.get_states().objects["cube"].pos[:, 2].clone())
    lifted = (torch.cat(begun) > 0.03).double().mean()
    assert 0.05 < float(lifted) < 0.5
    env.close()


def test_share_outside_0_to_1_is_refused():
    with pytest.raises(ConfigError, match=r"expert_starts is a share from 0 to 1, given 1\.5"):
        EnvSpec().make_torch(1, expert_starts=1.5)


def test_task_without_expert_is_refused():
    with pytest.raises(ConfigError, match="has no scripted expert"):
        EnvSpec(task="control/cartpole").make_torch(1, num_threads=1, bank_size=1, expert_starts=0.5)


def test_expert_that_gives_up_at_once_is_an_error(monkeypatch):
    monkeypatch.setattr(PickCube, "expert", lambda *_: [])
    with pytest.raises(
        ConfigError, match=r"The expert of PickCube left no state to start at: .* in all of 2"
    ):
        EnvSpec().make_torch(2, num_threads=1, bank_size=2, expert_starts=0.5)
