"""What every registered channel promises, on PickCube: episodes by index, splits, a task that is possible."""

import json

import numpy as np
import pytest

from envs.core.errors import MissingExtraError, SimulatorError
from envs.experts.actor import expert_episodes
from envs.randomization import CHANNELS, LEVEL_CHANNELS, channels_of
from envs.simulators import HANDLERS
from envs.spec import EnvSpec
from tests.sweeps import sweep

NAMES = sorted(CHANNELS.names())

NUM_EPISODES, NUM_SOLVED = 20, 18


def make(only, num_envs, split="train", simulator="mujoco", **options):
    spec = EnvSpec(task="PickCube", only=only, image_size=32, simulator=simulator)
    return spec.make(num_envs, split=split, num_threads=1, **options)


def looks(env, episodes):
    """Start, appearance and image of each episode."""
    found = {}
    for first in range(0, len(episodes), env.num_envs):
        some = episodes[first : first + env.num_envs]
        ids = np.arange(len(some))
        env.reset_envs(ids, some)
        images = env.observe(ids)["observation.images.front"]
        for env_id, episode in enumerate(some):
            flat = env.get_states([env_id]).flatten()
            states = {key: value[0].numpy().tobytes() for key, value in flat.items()}
            found[episode] = (env.initial_state_hash(env_id), states, images[env_id].tobytes())
    return found


@pytest.mark.slow
@pytest.mark.parametrize("only", sweep(NAMES, {"camera", "robot", "sensor", "layout"}))
def test_an_episode_is_the_same_for_any_number_of_environments_and_in_any_order(only):
    found = []
    for num_envs, backwards in ((1, False), (3, True)):
        env = make(only, num_envs)
        episodes = env.split_indices[:6].tolist()
        found.append(looks(env, episodes[::-1] if backwards else episodes))
        env.close()
    assert found[0] == found[1]
    assert len({look[0] for look in found[0].values()}) == 6


@pytest.fixture(scope="module")
def all_draws():
    """The draws of five episodes in which every channel varies."""
    env = make("+".join(NAMES), 1, observation="state")
    draws = {episode: env.randomizer.draws(episode) for episode in env.split_indices[:5].tolist()}
    env.close()
    return draws


@pytest.mark.parametrize("only", NAMES)
def test_draws_of_an_episode_do_not_depend_on_other_channels(only, all_draws):
    alone = make(only, 1, observation="state")
    for episode, draws in all_draws.items():
        assert alone.randomizer.draws(episode) == {only: draws[only]}
        assert json.loads(json.dumps(draws)) == draws
    alone.close()


@pytest.mark.parametrize("only", NAMES)
def test_the_splits_draw_nothing_in_common(only):
    draws = {}
    for split in ("train", "test"):
        env = make(only, 1, split, observation="state")
        draws[split] = {
            json.dumps(env.randomizer.draws(episode), sort_keys=True)
            for episode in env.split_indices[:100].tolist()
        }
        env.close()
    assert not draws["train"] & draws["test"]
    assert len(draws["train"]) > 1, "it varies"


@pytest.mark.slow
@pytest.mark.parametrize("only", sweep(NAMES, {"robot", "layout"}))
def test_the_expert_succeeds(only):
    env = make(only, 4, "test", observation="state")
    episodes = expert_episodes(env, env.split_indices[:NUM_EPISODES], record=())
    assert sum(episode.success for episode in episodes) >= NUM_SOLVED
    env.close()


@pytest.mark.long
@pytest.mark.parametrize("simulator", [name for name in HANDLERS.names() if name != "mujoco"])
@pytest.mark.parametrize("only", ["robot", "layout"])
def test_a_start_is_the_same_in_every_simulator(only, simulator):
    try:
        pair = [make(only, 2, simulator=name, observation="state") for name in ("mujoco", simulator)]
    except MissingExtraError as error:
        pytest.skip(str(error))
    except SimulatorError as error:
        if (simulator, only) != ("newton", "layout"):
            raise
        pytest.skip(str(error))  # it refuses scenes of so many shapes
    for env in pair:
        env.reset_envs([0, 1], env.split_indices[:2])
    ours, theirs = pair
    assert [ours.initial_state_hash(i) for i in (0, 1)] == [theirs.initial_state_hash(i) for i in (0, 1)]
    found = theirs.get_states().to("cpu").flatten()
    for key, values in ours.get_states().flatten().items():
        if key.endswith(("/pos", "/joint_pos")):
            np.testing.assert_allclose(found[key], values, atol=1e-5, err_msg=key)
    for env in pair:
        env.close()


def test_levels_vary_what_they_always_did():
    assert LEVEL_CHANNELS == ("task", "environment", "camera", "lighting")
    assert set(NAMES) >= {"environment", "camera", "lighting", "robot", "sensor", "layout"}
    for name in ("robot", "sensor", "layout"):
        assert channels_of(only=name) == ("task", name)
        assert not any(name in channels_of(level) for level in range(4))
