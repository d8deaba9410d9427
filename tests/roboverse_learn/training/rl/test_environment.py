"""The env of reinforcement learning; what it lacks is reported before the run has a folder."""

import importlib.util
import sys

import pytest

from envs.core.errors import ConfigError
from envs.core.extras import install_command
from envs.tasks.pick_cube import PickCube
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.reporter import Reporter


@pytest.mark.parametrize("policy", ["ppo", "tdmpc2", "fasttd3"])
def test_a_task_without_reward_is_refused(policy, monkeypatch, tmp_path):
    monkeypatch.setattr(PickCube, "has_reward", False)
    config = compose("train", [f"policy={policy}", "task=PickCube", "simulator=mujoco", "policy.num_envs=2"])
    with pytest.raises(ConfigError, match=f"'PickCube' has no reward, which policy={policy} learns from"):
        learner_of(config, "cpu").learn(tmp_path, None, 0, Reporter())
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("policy", ["ppo", "tdmpc2", "fasttd3"])
@pytest.mark.parametrize("word", ["level=3", "only=robot"])
def test_scenes_that_are_to_vary_in_training_are_refused(policy, word):
    config = compose("train", [f"policy={policy}", "task=PickCube", word])
    with pytest.raises(
        ConfigError, match=rf"policy={policy} learns at level 0, .* given {word}\. Leave it out"
    ):
        learner_of(config, "cpu").check()


def refused(words, tmp_path, monkeypatch, capsys):
    """Returns what a command says that must fail and leave nothing behind."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", *words.split()]) == 2
    assert not any(tmp_path.iterdir())
    return capsys.readouterr().err


@pytest.mark.parametrize("policy", ["ppo", "tdmpc2", "fasttd3"])
def test_a_refused_run_has_no_folder(policy, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(PickCube, "has_reward", False)
    said = refused(f"policy={policy} task=PickCube", tmp_path, monkeypatch, capsys)
    assert said.startswith(f"error: Task 'PickCube' has no reward, which policy={policy} learns from.")


@pytest.mark.parametrize(
    ("backend", "package", "extra"),
    [("rsl_rl", "rsl_rl", "rsl-rl"), ("sb3", "stable_baselines3", "sb3"), ("torchrl", "torchrl", "torchrl")],
)
def test_missing_backend_error_names_the_extra(backend, package, extra, tmp_path, monkeypatch, capsys):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find(name))
    said = refused(f"policy=ppo backend={backend} task=PickCube", tmp_path, monkeypatch, capsys)
    assert f"policy.backend={backend} needs the package '{package}', which is not installed." in said
    assert install_command(extra) in said


def test_missing_torchrl_error_of_tdmpc2(tmp_path, monkeypatch, capsys):
    ours = ("policies.tdmpc2", "roboverse_learn.training.rl.tdmpc2")
    for name in [each for each in sys.modules if each.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("torchrl", "torchrl.modules", "torchrl.modules.functional"):
        monkeypatch.setitem(sys.modules, name, None)
    said = refused("policy=tdmpc2 task=PickCube", tmp_path, monkeypatch, capsys)
    assert "policy=tdmpc2 needs the package 'torchrl'" in said and install_command("torchrl") in said


@pytest.mark.parametrize("policy", ["ppo", "act"])
@pytest.mark.parametrize("key", ["simulator", "renderer"])
def test_missing_simulator_or_renderer_is_refused(policy, key, tmp_path, monkeypatch, capsys):
    for name in [each for each in sys.modules if each.startswith(("sapien", "envs.simulators.sapien."))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "sapien", None)
    said = refused(f"policy={policy} task=PickCube {key}=sapien", tmp_path, monkeypatch, capsys)
    assert said.startswith(f"error: The {key} 'sapien' needs the package 'sapien', which is not installed.")


def test_starts_on_the_way_of_an_expert_need_one(tmp_path, monkeypatch, capsys):
    words = "policy=ppo preset=quick task=control/cartpole policy.expert_starts=0.5"
    assert refused(words, tmp_path, monkeypatch, capsys) == (
        "error: policy.expert_starts=0.5 lets episodes begin on the way of the task's scripted expert, and "
        "'control/cartpole' has none. Take policy.expert_starts=0, or a task with an expert, such as "
        "PickCube.\n"
    )
