"""Arguments that PPO's learner refuses and accepts."""

import importlib.util
import re
from dataclasses import replace

import pytest
import torch

import policies
from envs.core.errors import ConfigError, MissingExtraError, PolicyError
from envs.core.extras import install_command
from envs.tasks.control.cartpole import Cartpole
from policies.ppo.config import PpoConfig
from roboverse_learn.commands.run_identity import identity, run_name
from roboverse_learn.config.command_line_keys import at, flat_keys
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import to_values
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.rl.ppo import learner
from tests.roboverse_learn.training.rl.ppo.reach import Reach


def test_a_backend_that_is_not_installed_names_its_extra(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rsl_rl" else find(name))
    message = rf"backend=rsl_rl needs the package 'rsl_rl', .*{re.escape(install_command('rsl-rl'))}"
    with pytest.raises(MissingExtraError, match=message):
        learner.check_installed("rsl_rl")
    learner.check_installed("torchrl")


def test_events_come_after_whole_rollouts():
    config = learner.whole_rollouts(TrainConfig(steps=100, save_every=64, log_every=1), 32)
    assert (config.steps, config.save_every, config.log_every) == (128, 64, 32)


def test_the_command_line_reaches_ppo():
    config = compose("train", ["policy=ppo", "backend=sb3", "task=PickCube", "policy.num_envs=64", "lr=1e-3"])
    assert config.policy == PpoConfig(backend="sb3", num_envs=64)
    assert config.train.lr == 1e-3 and config.evaluate.levels == (0,)


@pytest.mark.slow
@pytest.mark.parametrize("policy", policies.names())
def test_pixels_preset_changes_ppo_alone(policy):
    plain, seeing = (
        to_values(compose("train", [f"policy={policy}", f"preset={name}"])) for name in ("full", "pixels")
    )
    changed = {key for key in flat_keys(plain) if at(plain, key) != at(seeing, key)}
    if policy != "ppo":
        assert changed == {"preset"}
        return
    assert {"image_size", "policy.observation", "train.steps"} <= changed
    assert (seeing["policy"]["observation"], seeing["image_size"]) == ("pixels", 64)
    assert seeing["train"]["time_limit_s"] is None  # it ends by steps


def test_runs_from_states_keep_their_names():
    plain, words = compose("train", ["policy=ppo"]), "policy.observation=pixels"
    assert not {"policy.observation", "policy.num_frames"} & set(identity(plain))
    assert run_name(plain) == "full-level0-seed0-764f26fd"  # before there were images
    assert identity(compose("train", ["policy=ppo", words]))["policy.observation"] == "pixels"
    assert run_name(compose("train", ["policy=ppo", words])) != run_name(plain)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["image_size=35"], r"image_size=35 is too small .* need 36 pixels a side"),
        (["image_size=64", "level=2"], r"policy=ppo learns at level 0, .* given level=2"),
    ],
)
def test_images_that_it_cannot_learn_from_are_refused(words, message):
    given = ["policy=ppo", "task=control/cartpole", "policy.observation=pixels", *words]
    with pytest.raises(ConfigError, match=message):
        learner.PpoLearner(compose("train", given), "cpu").check()


def test_images_that_are_not_square_are_refused(monkeypatch):
    scene = Cartpole().scenario
    wide = replace(scene, cameras=tuple(replace(camera, width=512) for camera in scene.cameras))
    monkeypatch.setattr(Cartpole, "scenario", property(lambda _: wide))
    config = compose(
        "train", ["policy=ppo", "task=control/cartpole", "policy.observation=pixels", "image_size=64"]
    )
    message = r"square images, and those of camera 'front' have 128 × 64 pixels. Take cameras="
    with pytest.raises(ConfigError, match=message):
        learner.PpoLearner(config, "cpu").check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backend": "jax"}, "backend must be one of rsl_rl, sb3, torchrl, given 'jax'"),
        ({"num_envs": 0}, "policy.num_envs must be above 0, given 0"),
        ({"gamma": 1.5}, "policy.gamma must be from 0 to 1, given 1.5"),
        ({"num_envs": 3, "num_steps": 5}, r"num_minibatches=8 does not divide a rollout of .*= 15 steps"),
        ({"hidden_dims": ()}, r"policy.hidden_dims needs a width per layer, given \[\]"),
    ],
)
def test_wrong_settings_are_named(changes, message):
    with pytest.raises(PolicyError, match=message):
        PpoConfig(**changes)


class Staggered(Reach):
    """Notes in which steps episodes end."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(num_envs)
        self.ends: list[int] = []

    def stagger(self) -> None:
        self.elapsed_steps = torch.arange(self.num_envs) % self.max_episode_steps

    def step(self, actions):
        step = super().step(actions)
        self.ends.append(int(step.truncated.sum()))
        return step


@pytest.mark.slow
@pytest.mark.parametrize("stagger", [True, False])
def test_staggered_first_episodes_end_at_different_times(tmp_path, stagger):
    config = PpoConfig(backend="torchrl", num_envs=30, num_steps=4, num_minibatches=2, stagger=stagger)
    env = Staggered(30)
    train = TrainConfig(steps=30 * 20, save_every=10**6, num_threads=1)
    learner.train(config, env, train, tmp_path, "PickCube")
    assert any(env.ends) == stagger and max(env.ends) <= 1
