"""What an agent is shown while it learns from images is what an evaluation shows it in the same state."""

import numpy as np
import pytest
import torch

from benchmark.runner import PolicyActor
from envs.rollout import rollout
from envs.spec import EnvSpec
from policies.stacked_images import stacked

TASK, CAMERAS, PUSHES = "control/cartpole", ("front", "rail"), (1.0, -0.7)


def spec(simulator):
    return EnvSpec(task=TASK, cameras=CAMERAS, image_size=64, simulator=simulator)


class Watcher:
    """Pushes the cart one way, and keeps the images that it is shown."""

    n_obs_steps, n_action_steps = 3, 1

    def __init__(self, push):
        self.push, self.shown = push, []

    def act(self, observation, generators):
        del generators
        sizes = {f"observation.images.{camera}": 64 for camera in CAMERAS}
        self.shown.append(stacked(observation, sizes, self.n_obs_steps, "watcher")[0])
        return np.full((1, 1, 1), self.push, np.float32)


def evaluated(simulator, episode):
    """What an evaluation shows of an episode until the cart is off its rail, for each push."""
    env = spec(simulator).make(actions="rl")
    watchers = [Watcher(push) for push in PUSHES]
    for watcher in watchers:
        list(rollout(env, PolicyActor(watcher, env, seed=0), [episode]))
    env.close()
    return [torch.stack(watcher.shown) for watcher in watchers]


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_training_images_equal_evaluation_images_after_a_reset(simulator):
    env = spec(simulator).make_torch(2, observation="pixels", bank_size=1, num_threads=1)
    expected = evaluated(simulator, 0)
    lengths = [len(each) for each in expected]
    assert 10 < lengths[0] < lengths[1] < 100, "one restarts while the other continues"
    obs, actions, done = env.reset(), torch.tensor(PUSHES)[:, None], torch.zeros(2, dtype=torch.int64)
    for _ in range(2 * lengths[1]):
        for i in range(2):
            assert obs[i].equal(expected[i][done[i] % lengths[i]]), f"step {done[i]} of the push {PUSHES[i]}"
        step = env.step(actions)
        assert (
            step.terminated == torch.tensor([(n + 1) % m == 0 for n, m in zip(done, lengths, strict=True)])
        ).all()
        obs, done = step.obs, done + 1
    env.close()
