"""PPO of images by the commands: from the words of the command line to a result, and what is seen there."""

import json

import pytest
import torch

pytest.importorskip("rsl_rl")

import policies
from benchmark.runner import evaluate_cell
from envs.spec import EnvSpec
from envs.tasks.control.cartpole import Cartpole
from policies.ppo.policy import PpoPolicy
from roboverse_learn.config.compose import compose
from roboverse_learn.train import train
from roboverse_learn.training.metrics import read_metrics

pytestmark = pytest.mark.slow

CAMERAS = ("front", "rail")
SIZES = {"observation.images.front": 40, "observation.images.rail": 40, "observation.state": 2}
WORDS = (
    "policy=ppo", "preset=pixels", "task=control/cartpole", "simulator=mujoco", "device=cpu", "image_size=40",
    "cameras=[front,rail]", "policy.num_frames=2", "policy.num_envs=4", "policy.num_steps=4",
    "policy.num_minibatches=2", "policy.num_epochs=1", "policy.hidden_dims=[8]", "train.steps=48",
    "train.log_every=16", "train.save_every=32", "train.num_threads=1", "episodes=2", "evaluate.num_envs=2",
    "evaluate.levels=[0,1]", "evaluate.splits=[test]", "videos=0",
)  # fmt: skip


def run(folder, *words):
    train(compose("train", [*WORDS, f"run={folder}/run", f"results_dir={folder}/results", *words]))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pixels")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cartpole, "max_episode_steps", 3)
        run(folder)
    return folder


def test_result_names_cameras_and_pixels(trained):
    (path,) = (trained / "results").rglob("run.json")
    result = json.loads(path.read_text())
    assert result["sees_images"] and (result["policy"], result["checkpoint"]["step"]) == ("ppo", 48)
    assert (result["env"]["cameras"], result["env"]["image_size"]) == (["front", "rail"], 40)
    assert [(each["level"], each["length"]) for each in result["records"]] == [(0, [3, 3]), (1, [3, 3])]
    policy = policies.load(trained / "run")
    assert (policy.sizes, policy.n_obs_steps, policy.task) == (SIZES, 2, "control/cartpole")
    assert [row["step"] for row in read_metrics(trained / "run")] == [16, 32, 48]


def test_run_that_was_cut_ends_with_the_same_weights(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(Cartpole, "max_episode_steps", 3)
    run(tmp_path, "train.steps=32")
    before = policies.load(tmp_path / "run").state_dict()
    run(tmp_path)
    for key, weight in policies.load(trained / "run").state_dict().items():
        assert policies.load(tmp_path / "run").state_dict()[key].equal(weight), key
        assert key.startswith("norm.norm") or not before[key].equal(weight), key


def test_an_evaluation_sees_what_it_learned_from(trained, monkeypatch):
    monkeypatch.setattr(Cartpole, "max_episode_steps", 5)
    spec = EnvSpec(task="control/cartpole", cameras=CAMERAS, image_size=40)
    ours = spec.make_torch(1, observation="pixels_and_state", num_frames=2, bank_size=1, num_threads=1)
    seen = [ours.reset(), *(ours.step(torch.full((1, 1), 0.3)).obs for _ in range(4))]
    ours.close()
    given = []

    class Pushes(PpoPolicy):
        def actions(self, seen, generators):
            given.append(seen)
            return torch.full((1, 1), 0.3)

    theirs = spec.make(actions="rl", num_threads=1)
    evaluate_cell(
        Pushes.load(trained / "run/checkpoints/last"), theirs, theirs.split_indices[:1].tolist(),
        split="train", level=0, seed=0, policy_name="ppo",
    )  # fmt: skip
    theirs.close()
    assert len(given) == 5
    for mine, of_evaluation in zip(seen, given, strict=True):
        assert mine.equal(of_evaluation)
