"""EnvSpec: plain data that makes environments."""

import contextlib
import json

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import RoboVerseError, UnknownNameError
from envs.pixel_env import PixelVectorEnv
from envs.spec import EnvSpec

CHANGED = EnvSpec(
    task="control/cartpole",
    simulator_settings={"impratio": 2.0},
    cameras=("rail", "front"),
    image_size=32,
    scenario={"physics": {"decimation": 4}},
    only="lighting",
)


def test_json_round_trip():
    text = json.dumps(CHANGED.to_json())
    assert EnvSpec.from_json(json.loads(text)) == CHANGED
    assert EnvSpec.from_json({}) == EnvSpec.from_json({"level": None, "cameras": None}) == EnvSpec()


def test_hash_depends_on_values_alone_and_never_changes():
    assert EnvSpec().hash == EnvSpec.from_json(EnvSpec().to_json()).hash == "45f25e945f9e693a"
    assert CHANGED.hash == "d530efa5895cf45d"
    ordered = EnvSpec(task_kwargs={"a": 1, "b": 2})
    assert ordered.hash == EnvSpec(task_kwargs={"b": 2, "a": 1}).hash
    assert ordered.hash != ordered.replace(level=1).hash


def test_unknown_field_suggests_nearest():
    with pytest.raises(UnknownNameError, match=r"field of an environment 'image_sze'.*'image_size'"):
        EnvSpec.from_json({"image_sze": 32})
    with pytest.raises(UnknownNameError, match=r"keyword argument 'num_thread'.*'num_threads'"):
        envs.make_vec("PickCube", num_thread=1)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"image_size": 8}, "image_size must be 16 to 2048 pixels, given 8"),
        ({"level": 4}, "Unknown level '4'"),
        ({"level": 1, "only": "camera"}, "give one of them"),
        ({"only": "camra"}, "Did you mean 'camera'"),
    ],
)
def test_values_out_of_range_are_refused(values, message):
    with pytest.raises(RoboVerseError, match=message):
        EnvSpec(**values)


def test_make_applies_every_field():
    env = CHANGED.make(2, split="test", num_threads=1, protocol_seed=7)
    with contextlib.closing(env):
        assert env.env_spec is CHANGED and env.num_envs == 2 and env.protocol_seed == 7
        assert env.task.name == "control/cartpole" and env.channels == ("task", "lighting")
        assert env.scenario.physics.decimation == 4
        assert env.handler.physics_model.opt.impratio == 2.0
        assert set(env.split_indices) == set(envs.randomization.load_split("test").episodes)
        env.reset(seed=0)
        assert env.observe()["observation.images.rail"].shape == (2, 32, 32, 3)


def test_make_torch_gives_states_or_images():
    states = CHANGED.make_torch(2, bank_size=2, num_threads=1, substeps=2)
    assert states.env_spec is CHANGED and states.scenario.physics.decimation == 2
    assert states.reset().dtype == torch.float32
    states.close()
    images = CHANGED.make_torch(2, observation="pixels", num_frames=2, bank_size=2, num_threads=1)
    assert isinstance(images, PixelVectorEnv) and images.env_spec is CHANGED
    assert images.reset().shape == (2, 2 * 6, 32, 32)
    images.close()
    with pytest.raises(UnknownNameError, match=r"Unknown observation 'pixel'.*Did you mean 'pixels'"):
        CHANGED.make_torch(2, observation="pixel")


def test_observation_has_the_instruction():
    with contextlib.closing(EnvSpec().make(3, observation="state", num_threads=1)) as env:
        env.reset_envs([0, 1, 2], env.split_indices[:3])
        assert env.observe([2, 0])["task"].tolist() == [env.instruction(2), env.instruction(0)]


@pytest.mark.slow
def test_single_environment_and_batch_carry_equal_specs():
    options = {"observation": "state", "task_kwargs": {"variant": "lift"}, "num_threads": 1}
    batch, single = envs.make_vec("PickCube", 2, **options), envs.RoboVerseEnv("PickCube", **options)
    with contextlib.closing(batch), contextlib.closing(single):
        assert batch.env_spec == single.env_spec == EnvSpec(task_kwargs={"variant": "lift"})
        np.testing.assert_array_equal(batch.single_action_space.low, single.action_space.low)
