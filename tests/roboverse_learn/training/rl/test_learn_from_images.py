"""TD-MPC2 of images: from the words of the command line to a checkpoint that can be evaluated."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from benchmark.runner import evaluate_cell
from envs.core.errors import CheckpointError, ConfigError, UnknownNameError
from envs.spec import EnvSpec
from envs.tasks.control.cartpole import Cartpole
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.policy import Tdmpc2Policy
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.config.compose import compose
from roboverse_learn.evaluate import evaluate_checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl import loop as rl_loop
from roboverse_learn.training.rl.tdmpc2 import Tdmpc2Algorithm
from tests.roboverse_learn.training.point_mass import GOOD_RETURN, RANDOM_RETURN, STEPS, PointMass

pytestmark = pytest.mark.slow

WORDS = (
    "policy=tdmpc2", "task=control/cartpole", "simulator=mujoco", "policy.observation=pixels",
    "image_size=64", "policy.num_envs=4", "policy.batch_size=16", "model_size=1", "enc_dim=16", "mlp_dim=16",
    "latent_dim=16", "num_channels=4", "num_samples=16", "num_elites=4", "num_pi_trajs=4", "iterations=2",
    "seed_steps=16", "buffer_size=400", "train.steps=96", "save_every=48", "log_every=24",
    "train.num_threads=1",
)  # fmt: skip


def learn(folder, *words):
    return learner_of(compose("train", [*WORDS, *words]), "cpu").learn(folder, None, 3, Reporter())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pixels")
    learn(folder, "cameras=[front,rail]")
    return folder


def test_trained_policy_has_its_cameras(trained):
    policy = policies.load(trained)
    assert policy.sizes == {"observation.images.front": 64, "observation.images.rail": 64}
    assert (policy.n_obs_steps, policy.task) == (3, "control/cartpole")
    losses = [row["loss"] for row in read_metrics(trained) if "loss" in row]
    assert np.isfinite(losses).all() and losses[-1] < losses[0]


def test_run_resumes_to_the_same_weights(trained, tmp_path):
    learn(tmp_path, "cameras=[front,rail]", "train.steps=48")
    learn(tmp_path, "cameras=[front,rail]")
    for key, value in policies.load(trained).state_dict().items():
        assert policies.load(tmp_path).state_dict()[key].equal(value), key


def test_the_replay_holds_bytes_and_is_of_these_cameras_alone(trained, tmp_path):
    from safetensors.torch import load_file

    state = trained / "checkpoints/last/training_state"
    frames = load_file(state / "state.safetensors")["algorithm.replay.frame"]
    assert frames.dtype == torch.uint8 and frames.shape[1:] == (4, 6, 64, 64)
    assert 25 <= len(frames) < 100  # 24 steps, the ends of episodes, and no more than that
    assert json.loads((state / "state.json").read_text())["numbers"]["algorithm"]["replay"] == {"added": 24}
    learn(tmp_path, "train.steps=48")
    with pytest.raises(CheckpointError, match=r"cameras was \['front'\] and is \['front', 'rail'\]"):
        learn(tmp_path, "cameras=[front,rail]")


def test_an_evaluation_sees_what_it_learned_from(trained, monkeypatch):
    monkeypatch.setattr(Cartpole, "max_episode_steps", 5)
    spec = EnvSpec(task="control/cartpole", cameras=("front", "rail"), image_size=64)
    ours = spec.make_torch(1, observation="pixels", bank_size=1, num_threads=1)
    seen = [ours.reset(), *(ours.step(torch.full((1, 1), 0.3)).obs for _ in range(4))]
    ours.close()
    given = []

    class Pushes(Tdmpc2Policy):
        def actions(self, seen, generators):
            given.append(seen)
            return torch.full((1, 1), 0.3)

    theirs = spec.make(actions="rl", num_threads=1)
    evaluate_cell(
        Pushes.load(trained), theirs, theirs.split_indices[:1].tolist(), split="train", level=0, seed=0,
        policy_name="tdmpc2",
    )  # fmt: skip
    theirs.close()
    assert len(given) == 5
    for mine, of_evaluation in zip(seen, given, strict=True):
        assert mine.equal(of_evaluation)


def test_it_is_evaluated_with_the_cameras_of_its_training(tmp_path, monkeypatch):
    monkeypatch.setattr(Cartpole, "max_episode_steps", 6)
    folder = tmp_path / "runs/control/cartpole/tdmpc2/it"
    learn(folder, "cameras=[rail]", "train.steps=24", "policy.plan=false")
    words = [f"checkpoint={folder}", "task=control/cartpole", "device=cpu", "splits=[test]", "levels=[0,3]"]
    config = compose("evaluate", [*words, "episodes=2", "evaluate.num_envs=2"])
    tested = checkpoint_to_test(config)
    result = evaluate_checkpoint(tested, config.evaluate, tmp_path / "results", "evaluate").result
    assert (result.env.cameras, result.env.image_size) == (("rail",), 64)
    assert [record.length for record in result.records] == [6] * 4


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (
            ["image_size=128"],
            ConfigError,
            r"images of 64 pixels a side, given image_size=128.*image_size=64",
        ),
        (["level=2"], ConfigError, r"learns at level 0, .*given level=2.*evaluate.levels"),
        (["only=camera"], ConfigError, r"learns at level 0, .*given only=camera"),
        (["cameras=[top]"], UnknownNameError, r"camera 'top'.*front, rail"),
    ],
)
def test_images_that_cannot_be_had_are_errors(words, error, said, tmp_path):
    with pytest.raises(error, match=said):
        learn(tmp_path, *words)
    assert not any(tmp_path.iterdir())


def test_task_without_a_camera_is_refused_before_the_run(monkeypatch, tmp_path):
    scene = replace(Cartpole().scenario, cameras=())
    monkeypatch.setattr(Cartpole, "scenario", property(lambda _: scene))
    with pytest.raises(ConfigError, match=r"'control/cartpole' has no camera.*policy.observation=state"):
        learner_of(compose("train", [*WORDS, f"run={tmp_path / 'run'}"]), "cpu").check()


class FilmedPointMass(PointMass):
    """A point mass that is seen: a bright column of a dark image, in the last three frames."""

    def __init__(self, num_envs, seed=0):
        super().__init__(num_envs, seed)
        self.frames = torch.zeros(num_envs, 9, 64, 64, dtype=torch.uint8)

    def _draw(self):
        columns = torch.arange(64) - 32.0 - 12.0 * self.position[:, None]
        bright = (255.0 * torch.exp(-columns.square() / 8.0)).to(torch.uint8)
        return bright[:, None, None].expand(-1, 3, 64, -1)

    def _observe(self):
        self.frames = torch.cat([self.frames[:, 3:], self._draw()], dim=1)
        return self.frames

    def reset(self, mask=None):
        before = self.frames
        super().reset(mask)
        first = self._draw().repeat(1, 3, 1, 1)
        self.frames = first if mask is None else torch.where(mask[:, None, None, None], first, before)
        return self.frames


@pytest.mark.long
def test_it_learns_from_images(tmp_path):
    config = Tdmpc2Config(
        observation="pixels", model_size=1, enc_dim=32, mlp_dim=64, latent_dim=128, num_channels=8,
        num_bins=51, simnorm_dim=4, num_samples=48, num_elites=8, num_pi_trajs=8, iterations=3, num_envs=8,
        batch_size=32, seed_steps=200, update_ratio=0.5, buffer_size=4000, lr=1e-3, enc_lr_scale=1.0,
    )  # fmt: skip
    policy = Tdmpc2Policy.create(config, {"observation.images.front": 64}, 1, STEPS)
    algorithm = Tdmpc2Algorithm(policy, config.num_envs, STEPS)
    settings = TrainConfig(steps=1400, log_every=200, save_every=4000, num_threads=1)
    rl_loop.run(algorithm, FilmedPointMass(config.num_envs), settings, tmp_path)
    rows = [row for row in read_metrics(tmp_path) if "episode_return" in row]
    assert rows[0]["episode_return"] < RANDOM_RETURN + 2.0, "before the first update"
    assert rows[-1]["episode_return"] > GOOD_RETURN
