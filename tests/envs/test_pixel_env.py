"""The environment with images as tensors, for reinforcement learning."""

import itertools
from dataclasses import replace

import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.pixel_env import PixelAndStateVectorEnv, PixelVectorEnv
from envs.simulators.mujoco.handler import MujocoHandler
from envs.spec import EnvSpec
from envs.tasks.control.cartpole import Cartpole
from policies.byte_rows import row_size, unpack


def make(num_envs=2, *, cameras=(), simulator="mujoco", **options):
    spec = EnvSpec(task="control/cartpole", cameras=cameras, image_size=64, simulator=simulator)
    return spec.make_torch(num_envs, **{"observation": "pixels", "bank_size": 5, "num_threads": 1} | options)


@pytest.fixture
def numbered(monkeypatch):
    """The k-th frame of an environment shows the number k, and 50 more with each environment."""

    def draw(self, ids=None):
        ids = torch.arange(self.num_envs) if ids is None else ids
        drawn = self.__dict__.setdefault("drawn", itertools.count())
        number = (50 * ids + next(drawn)).to(torch.uint8)
        return number[:, None, None, None].expand(-1, 3, 64, 64)

    monkeypatch.setattr(PixelVectorEnv, "_draw", draw)


def numbers(stack):
    """The numbers of the frames of every environment, the oldest first; all channels and pixels have one."""
    frames = stack.unflatten(1, (-1, 3))
    assert (frames == frames[:, :, :1, :1, :1]).all()
    return frames[:, :, 0, 0, 0].tolist()


@pytest.mark.usefixtures("numbered")
def test_observation_is_the_last_three_frames_and_repeats_the_first():
    env = make(max_episode_steps=4)
    env.elapsed_steps = torch.tensor([0, 2])  # the second episode has two steps left
    seen, ends = [numbers(env._frames)], []
    for _ in range(4):
        step = env.step(torch.zeros(2, 1))
        seen.append(numbers(step.obs))
        ends.append(numbers(step.final_obs))
    env.close()
    assert [each[0] for each in seen] == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 4], [6, 6, 6]]
    assert [each[1] for each in seen] == [
        [50, 50, 50], [50, 50, 51], [53, 53, 53], [53, 53, 54], [53, 54, 55],
    ]  # fmt: skip
    assert [each[0] for each in ends] == [[0, 0, 1], [0, 1, 2], [1, 2, 4], [2, 4, 5]]
    assert ends[1][1] == [50, 51, 52]


@pytest.mark.usefixtures("numbered")
@pytest.mark.parametrize("num_envs", [1, 2, 5])
def test_every_environment_keeps_its_own_frames(num_envs):
    env = make(num_envs, max_episode_steps=3)
    env.elapsed_steps = torch.arange(num_envs) % 3
    history = [[each[-1]] * 3 for each in numbers(env._frames)]
    for _ in range(7):
        step = env.step(torch.zeros(num_envs, 1))
        over = (step.terminated | step.truncated).tolist()
        last, now = numbers(step.final_obs), numbers(step.obs)
        for i in range(num_envs):
            assert last[i][:2] == history[i][1:]
            assert now[i] == ([now[i][0]] * 3 if over[i] else last[i])
            assert all(number // 50 == i for number in now[i])
        history = now
    env.close()


@pytest.mark.usefixtures("numbered")
def test_masked_environments_reset():
    env = make(3)
    env.step(torch.zeros(3, 1))
    assert numbers(env.reset(torch.tensor([False, True, False]))) == [[0, 0, 1], [52] * 3, [100, 100, 101]]
    assert numbers(env.reset(torch.zeros(3, dtype=torch.bool)))[1] == [52] * 3
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_shapes_and_types(simulator):
    env = make(simulator=simulator, cameras=("front", "rail"), num_frames=2)
    assert (env.observation_shape, env.camera_names) == ((12, 64, 64), ("front", "rail"))
    before = env.reset()
    step = env.step(torch.ones(2, 1))
    assert step.obs.shape == (2, 12, 64, 64) and step.obs.dtype == torch.uint8
    assert step.obs[:, :6].equal(before[:, 6:]) and not step.obs[:, 6:].equal(before[:, 6:])
    assert env.image().shape == (64, 64, 3)
    env.close()


def test_saved_state_resumes():
    env = make()
    for _ in range(2):
        env.step(torch.ones(2, 1))
    saved = {key: value.clone() for key, value in env.state_dict().items()}
    expected = [env.step(torch.ones(2, 1)).obs for _ in range(3)]
    env.reset()
    assert env.load_state_dict(saved).equal(saved["frames"])
    for each in expected:
        assert env.step(torch.ones(2, 1)).obs.equal(each)
    env.close()


def test_state_observation_renders_nothing(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("an image was rendered")

    for name in ("render_jobs", "render_tensors", "snapshot"):
        monkeypatch.setattr(MujocoHandler, name, refuse)
    env = make(observation="state", max_episode_steps=2)
    for _ in range(3):
        env.step(torch.zeros(2, 1))
    env.close()


def test_task_without_camera_is_refused(monkeypatch):
    scene = replace(Cartpole().scenario, cameras=())
    monkeypatch.setattr(Cartpole, "scenario", property(lambda _: scene))
    with pytest.raises(ConfigError, match=r"'control/cartpole' has no camera.*policy.observation=state"):
        make()


def test_unknown_camera_suggests_nearest():
    with pytest.raises(UnknownNameError, match=r"camera 'frnot'. Did you mean 'front'.*front, rail"):
        make(cameras=("frnot",))


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_robots_own_state_is_beside_each_frame(simulator):
    cameras = ("front", "rail")
    env = make(3, observation="pixels_and_state", simulator=simulator, cameras=cameras, num_frames=2)
    assert isinstance(env, PixelAndStateVectorEnv)
    shape, num_state = (6, 64, 64), env.num_state
    assert env.observation_shape == (2 * row_size(shape, num_state),)
    env.elapsed_steps = torch.tensor([0, 0, env.max_episode_steps - 2])  # the last ends in the second step
    before = env.reset(torch.zeros(3, dtype=torch.bool))
    for action in (1.0, -0.5):
        step = env.step(torch.full((3, 1), action))
        images, state = unpack(step.obs.unflatten(1, (2, -1)), shape)
        own = env.task.proprioception(env.get_states())
        assert state[:, 1].equal(own.float().to(state.device))
        drawn = env.handler.render_tensors(None, cameras)
        expected = torch.cat([drawn[camera]["rgb"] for camera in cameras], dim=-1).permute(0, 3, 1, 2)
        assert images[:, 1].equal(expected)
        lived = ~(step.terminated | step.truncated)
        assert step.obs[lived, : env.observation_size // 2].equal(before[lived, env.observation_size // 2 :])
        before = step.obs
    assert step.truncated.tolist() == [False, False, True]
    images, state = unpack(step.obs.unflatten(1, (2, -1)), shape)
    assert images[2, 0].equal(images[2, 1]) and state[2, 0].equal(state[2, 1])
    assert not step.final_obs[2].equal(step.obs[2])
    env.close()
