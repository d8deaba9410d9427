"""Images of a handler that disturbs them: once, alike wherever they are rendered, and in every batch."""

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError
from envs.experts.actor import ExpertActor
from envs.playback import PlaybackEnv, ReplayActor
from envs.randomization.disturbances import disturb_arrays
from envs.rollout import rollout
from envs.scenario import SensorCfg
from envs.simulators.disturbed import DisturbedHandler
from envs.spec import EnvSpec

SPEC = EnvSpec(task="PickCube", only="sensor", image_size=48, cameras=("front", "wrist"))


def make(num_envs=1, spec=SPEC, split="train", **options):
    return spec.make(num_envs, split=split, num_threads=1, **options)


@pytest.fixture(scope="module")
def envs():
    """Environments with disturbed images, and with images as they are rendered."""
    pair = make(2), make(2, EnvSpec(task="PickCube", image_size=48, cameras=("front", "wrist")))
    yield pair
    for env in pair:
        env.close()


def noisy_episodes(env, count):
    found = [
        int(episode)
        for episode in env.split_indices[:60]
        if env.randomizer.draws(int(episode))["sensor"]["sensor"]["gaussian_noise"] > 0
    ]
    return found[:count]


def test_only_a_channel_that_disturbs_images_costs_anything(envs):
    disturbed, plain = envs
    assert isinstance(disturbed.handler, DisturbedHandler)
    assert type(plain.handler) is type(disturbed.handler.handler)


def test_an_image_is_disturbed_once_however_it_is_rendered(envs):
    disturbed, plain = envs
    episodes = noisy_episodes(disturbed, 2)
    for env in envs:
        env.reset(options={"episodes": episodes})
    lazy = disturbed.step(np.zeros((2, 9), np.float32))[0]
    plain.step(np.zeros((2, 9), np.float32))
    clean = plain.observe()
    sensors = [disturbed.randomizer.appearance(episode).sensor for episode in episodes]
    steps = disturbed.scenario.physics.decimation
    seen = disturbed.observe()
    tensors = disturbed.handler.render_tensors(None, ("front", "wrist"))
    for camera in ("front", "wrist"):
        key = f"observation.images.{camera}"
        once = disturb_arrays(clean[key], sensors, [steps, steps], camera)
        assert not np.array_equal(once, clean[key])
        assert np.array_equal(seen[key], once)
        assert np.array_equal(lazy["pixels"][camera], once)
        assert np.array_equal(tensors[camera]["rgb"].numpy(), once)
    assert np.array_equal(disturbed.image(1), seen["observation.images.front"][1])
    assert np.array_equal(disturbed.render()[0], seen["observation.images.front"][0])


def test_states_depth_and_segmentation_are_not_disturbed(envs):
    disturbed, plain = envs
    for env in envs:
        env.reset(options={"episodes": noisy_episodes(disturbed, 2)})
    for key, value in plain.get_states().flatten().items():
        assert torch.equal(disturbed.get_states().flatten()[key], value)
    ours, theirs = (env.handler.render(("front",), ("depth", "segmentation"))["front"] for env in envs)
    assert np.array_equal(ours["depth"], theirs["depth"])
    assert np.array_equal(ours["segmentation"], theirs["segmentation"])
    assert disturbed.handler.segmentation_names == plain.handler.segmentation_names


def test_a_lazy_observation_shows_the_noise_of_its_own_time(envs):
    disturbed, _ = envs
    disturbed.reset(options={"episodes": noisy_episodes(disturbed, 2)})
    late = disturbed.step(np.zeros((2, 9), np.float32))[0]
    at_once = disturbed.observe()["observation.images.front"]
    disturbed.step(np.zeros((2, 9), np.float32))
    assert np.array_equal(late["pixels"]["front"], at_once)


def test_noise_changes_from_frame_to_frame_of_a_scene_that_stands(envs):
    disturbed, _ = envs
    disturbed.reset(options={"episodes": noisy_episodes(disturbed, 2)})
    handler = disturbed.handler
    state = disturbed.get_states()
    frames = []
    for _ in range(2):
        handler.set_states(state)
        frames.append(handler.render(("front",))["front"]["rgb"])
    assert not np.array_equal(*frames)


def test_a_look_that_changes_leaves_an_episode_its_noise(envs):
    episode, other = noisy_episodes(envs[0], 2)
    handler = envs[0].handler
    envs[0].reset(options={"episodes": [episode, other]})
    envs[0].step(np.zeros((2, 9), np.float32))
    before = handler.render(("front",), env_ids=[0])["front"]["rgb"]
    handler.change_look(envs[0].randomizer.appearance(other), 0)  # only="sensor": all else is as before
    np.testing.assert_array_equal(handler.render(("front",), env_ids=[0])["front"]["rgb"], before)
    handler.set_appearance(envs[0].randomizer.appearance(other), 0)
    assert (handler.render(("front",), env_ids=[0])["front"]["rgb"] != before).any()


def test_snapshots_can_be_rendered_one_by_one(envs):
    disturbed, _ = envs
    disturbed.reset(options={"episodes": noisy_episodes(disturbed, 2)})
    jobs = disturbed.handler.snapshot()
    together = disturbed.handler.render_jobs(jobs, ("front",))["front"]["rgb"]
    listed = disturbed.handler.render_jobs([jobs[0], jobs[1]], ("front",))["front"]["rgb"]
    part = disturbed.handler.render_jobs(jobs[1:], ("front",))["front"]["rgb"]
    assert len(jobs) == 2
    assert np.array_equal(listed, together) and np.array_equal(part, together[1:])


def recorded(env, episodes):
    """The first frames of the expert's episodes, by index."""
    found, env.max_episode_steps = {}, 8
    for episode in rollout(env, ExpertActor(env), episodes, record=("images", "states")):
        found[episode.episode] = episode
    return found


@pytest.mark.slow
def test_a_replay_of_states_shows_the_same_images(envs):
    """As ``source=rerender`` does: at the level of the dataset its first look is the dataset's own."""
    disturbed, _ = envs
    episodes = noisy_episodes(disturbed, 2)
    first = recorded(disturbed, episodes)
    actor = ReplayActor(
        [first[e].states.select([0]) for e in episodes], [first[e].actions for e in episodes], hold_steps=0
    )
    assert all(first[episode].length == 8 for episode in episodes)
    playback = PlaybackEnv(disturbed, [first[e].states for e in episodes])
    for episode in rollout(playback, actor, episodes, record=("images", "states")):
        for camera, images in episode.images.items():
            assert np.array_equal(images, first[episode.episode].images[camera])


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", pytest.param("mujoco_warp", marks=pytest.mark.long)])
def test_images_of_an_episode_are_the_same_for_any_number_of_environments(simulator):
    images = []
    for num_envs in (1, 3):
        try:
            env = make(num_envs, SPEC.replace(simulator=simulator))
        except MissingExtraError as error:
            pytest.skip(str(error))
        images.append(recorded(env, noisy_episodes(env, 3)))
        env.close()
    for index, episode in images[0].items():
        assert episode.length == images[1][index].length
        for camera, frames in episode.images.items():
            assert np.array_equal(frames, images[1][index].images[camera])


def test_an_episode_with_another_sensor_has_another_hash(envs):
    disturbed, plain = envs
    episodes = noisy_episodes(disturbed, 2)
    for env in envs:
        env.reset(options={"episodes": episodes})
    assert disturbed.initial_state_hash(0) != plain.initial_state_hash(0)


@pytest.mark.slow
def test_a_scene_may_have_a_sensor_of_its_own_in_numpy_and_torch():
    """``scenario.appearance.sensor`` disturbs the images of every episode; no channel varies."""
    spec = EnvSpec(task="PickCube", image_size=32, scenario={"appearance": {"sensor": {"blur_sigma": 0.03}}})
    blurred, plain = make(1, spec), make(1, EnvSpec(task="PickCube", image_size=32))
    for env in (blurred, plain):
        env.reset_envs([0], env.split_indices[:1])
    images = [env.observe()["observation.images.front"] for env in (blurred, plain)]
    expected = disturb_arrays(images[1], [SensorCfg(blur_sigma=0.03)], [0], "front")
    assert np.array_equal(images[0], expected) and not np.array_equal(*images)
    torch_env = spec.make_torch(1, observation="pixels", num_frames=1, num_threads=1)
    state = plain.get_states()
    torch_env.handler.set_states(state)
    frame = torch_env.handler.render_tensors()["front"]["rgb"]
    assert isinstance(torch_env.handler, DisturbedHandler) and np.array_equal(frame.numpy(), expected)
    assert torch_env.reset().shape == (1, 3, 32, 32)
    for env in (blurred, plain, torch_env):
        env.close()
