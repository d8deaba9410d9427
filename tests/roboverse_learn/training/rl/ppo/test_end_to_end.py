"""``train.py policy=ppo``: from the words of the command line to a row of the leaderboard."""

import json

import numpy as np
import pytest

pytest.importorskip("rsl_rl")
pytest.importorskip("stable_baselines3")
pytest.importorskip("torchrl")

import policies
from benchmark.learning_curves import read_curve
from envs.core.errors import ConfigError, PolicyError
from envs.tasks.pick_cube import PickCube
from policies.ppo.config import BACKENDS
from roboverse_learn.config.compose import compose
from roboverse_learn.evaluate import evaluate
from roboverse_learn.leaderboard import write_leaderboard
from roboverse_learn.train import train
from roboverse_learn.training.metrics import read_metrics

TINY = (
    "policy=ppo", "task=PickCube", "device=cpu", "policy.num_envs=4", "policy.num_steps=4",
    "policy.num_minibatches=2", "policy.num_epochs=1", "policy.hidden_dims=[8]", "train.steps=48",
    "train.log_every=16", "train.save_every=32", "train.num_threads=1", "image_size=32", "episodes=2",
    "evaluate.num_envs=2", "videos=0",
)  # fmt: skip


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Episodes end after three steps."""
    monkeypatch.setattr(PickCube, "max_episode_steps", 3)


def run(folder, *words):
    config = compose("train", [*TINY, f"runs_dir={folder}/runs", f"results_dir={folder}/results", *words])
    train(config)
    return config


def results_of(folder):
    paths = sorted((folder / "results").glob("*/PickCube/ppo/*.json"))
    return [json.loads(path.read_text()) for path in paths]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder in which every backend has been trained and evaluated."""
    folder = tmp_path_factory.mktemp("ppo")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PickCube, "max_episode_steps", 3)
        for backend in BACKENDS:
            run(folder, f"backend={backend}", "simulator=mujoco", "levels=[0,1]", "splits=[test]")
    return folder


@pytest.mark.slow
def test_every_backend_leaves_a_result_that_names_it(finished):
    results = {result["config"]["policy"]["backend"]: result for result in results_of(finished)}
    assert sorted(results) == sorted(BACKENDS)
    for result in results.values():
        assert (result["policy"], result["env"]["task"], result["checkpoint"]["step"]) == (
            "ppo",
            "PickCube",
            48,
        )
        assert not result["sees_images"]
        assert result["dataset_hash"] is None and result["demonstrations"] is None
        assert [(r["level"], r["split"]) for r in result["records"]] == [(0, "test"), (1, "test")]
        assert all(cell["length"] == [3, 3] for cell in result["records"])
        assert all(np.isfinite(cell["episode_return"]).all() for cell in result["records"])


@pytest.mark.slow
def test_what_it_does_depends_on_no_looks(finished):
    for result in results_of(finished):
        plain, dressed = result["records"]
        assert (plain["level"], dressed["level"]) == (0, 1)
        assert plain["episode"] == dressed["episode"]
        assert plain["episode_return"] == dressed["episode_return"]


@pytest.mark.slow
def test_the_leaderboard_has_a_row_of_each(finished):
    written = write_leaderboard(finished / "results")
    (section,) = json.loads(written["json"].read_text())["sections"]
    labels = [row["label"] for row in section["rows"]]
    assert sorted(labels) == ["ppo by rsl_rl", "ppo by sb3", "ppo by torchrl"]
    page = written["html"].read_text()
    assert all(label in page for label in labels) and "256² pixels" not in page


@pytest.mark.slow
def test_a_run_is_made_of_curves_and_a_policy_but_no_dataset(finished):
    runs = sorted((finished / "runs" / "PickCube" / "ppo").iterdir())
    assert len(runs) == len(BACKENDS)
    for folder in runs:
        rows = read_metrics(folder)
        assert [row["step"] for row in rows] == [16, 32, 48]
        assert all(np.isfinite(row["episode_return"]) and row["episodes"] > 0 for row in rows)
        assert policies.load(folder).task == "PickCube"
        assert (folder / "losses.png").is_file()
    assert not (finished / "datasets").exists()


@pytest.mark.slow
def test_the_same_command_finds_everything_done(finished):
    before = {path: path.read_bytes() for path in (finished / "results").rglob("*.json")}
    run(finished, "backend=sb3", "simulator=mujoco", "levels=[0,1]", "splits=[test]")
    assert {path: path.read_bytes() for path in (finished / "results").rglob("*.json")} == before


@pytest.mark.long
def test_a_checkpoint_is_evaluated_in_another_simulator(finished):
    runs = (finished / "runs" / "PickCube" / "ppo").iterdir()
    (folder,) = (each for each in runs if policies.load(each).config.backend == "rsl_rl")
    words = [f"checkpoint={folder}", "simulator=mujoco_warp", "levels=[0]", "splits=[test]", "episodes=1"]
    words += ["evaluate.num_envs=1", "videos=0", "device=cpu", f"results_dir={finished}/elsewhere"]
    evaluate(compose("evaluate", words))
    (path,) = (finished / "elsewhere").glob("*/PickCube/ppo/*.json")
    assert json.loads(path.read_text())["env"]["simulator"] == "mujoco_warp"
    board = json.loads((finished / "elsewhere" / "leaderboard.json").read_text())
    (row,) = board["sections"][0]["rows"]
    assert row["label"] == "ppo by rsl_rl, trained in mujoco, rendered with warp"
    assert read_curve(path) is None and board["sections"][0]["curves"] == []  # it learned elsewhere


@pytest.mark.long
def test_it_learns_in_mujoco_warp_and_resumes(tmp_path):
    words = ["simulator=mujoco_warp", "levels=[0]", "splits=[test]", "episodes=1", "evaluate.num_envs=1"]
    run(tmp_path, *words)
    (result,) = results_of(tmp_path)
    assert (result["env"]["simulator"], result["config"]["policy"]["backend"]) == ("mujoco_warp", "rsl_rl")


@pytest.mark.slow
def test_a_checkpoint_of_another_task_is_refused(finished):
    folder = next((finished / "runs" / "PickCube" / "ppo").iterdir())
    words = [f"checkpoint={folder}", "task=StackCube", "device=cpu", f"results_dir={finished}/elsewhere"]
    with pytest.raises(PolicyError, match=r"'ppo' learned the task PickCube, not StackCube"):
        evaluate(compose("evaluate", words))


def test_a_task_without_reward_and_an_unknown_backend_are_refused(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match=r"policy.backend: .* 'rsl_rl', 'sb3' or 'torchrl', given 'jax'"):
        compose("train", ["policy=ppo", "backend=jax"])
    monkeypatch.setattr(PickCube, "has_reward", False)
    with pytest.raises(ConfigError, match="Task 'PickCube' has no reward, which policy=ppo learns from"):
        run(tmp_path)
    assert not list(tmp_path.rglob("*.safetensors"))


@pytest.mark.slow
def test_curve_is_beside_the_result_and_on_the_page(finished):
    for path in (finished / "results").glob("*/PickCube/ppo/*.json"):
        curve = read_curve(path)
        assert curve[:, 0].tolist() == [16.0, 32.0, 48.0] and np.isfinite(curve).all()
    written = write_leaderboard(finished / "results")
    assert "Reinforcement learning" in written["html"].read_text()
    assert any(name.startswith("learning") for name in written)
