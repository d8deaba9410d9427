"""Demonstrations of a policy trained by reinforcement learning."""

import json

import numpy as np
import pytest
import torch
import yaml

import envs
import policies
from envs.core.errors import ConfigError, PolicyError
from envs.experts.actor import expert_episodes
from envs.tasks.pick_cube import PickCube
from policies.ppo.config import PpoConfig
from policies.ppo.policy import PpoPolicy
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import to_values
from roboverse_learn.data.sources.policy import OBSERVATION, PolicyPlanner, find_demonstrator


@pytest.fixture
def checkpoint(tmp_path):
    torch.manual_seed(0)
    policy = PpoPolicy(PpoConfig(hidden_dims=(8,)), {OBSERVATION: 47}, 5)
    policy.task = "PickCube"
    policy.model.layers[-1].bias.data.uniform_(-1.0, 1.0)
    policy.save(tmp_path / "policy")
    return tmp_path / "policy"


@pytest.fixture
def easy(monkeypatch):
    """PickCube is solved where the cube is in front, and its episodes end after six steps."""
    monkeypatch.setattr(PickCube, "max_episode_steps", 6)
    monkeypatch.setattr(PickCube, "success", lambda _, state: state.objects["cube"].pos[:, 0] > 0.0)


def make(task="PickCube", num_envs=2, **kwargs):
    return envs.make_vec(task, num_envs, simulator="mujoco", num_threads=1, **kwargs)


@pytest.mark.slow
def test_recorded_task_actions_reproduce_the_states(checkpoint, easy):
    policy = policies.load(checkpoint)
    env, agent = make(observation="state"), make(observation="full", actions="rl")
    episodes = env.split_indices[:2].tolist()
    recorded = list(expert_episodes(env, episodes, PolicyPlanner(policy, env.task)))
    assert [each.actions.shape[1] for each in recorded] == [9, 9]
    agent.reset_envs(np.arange(2), episodes)
    for step in range(6):
        joints = agent.observe()["observation.state"]
        for row, each in enumerate(recorded):
            if step < len(each.actions):
                np.testing.assert_allclose(each.observation_state[step], joints[row], atol=1e-5)
        agent.step_envs(np.arange(2), policy.act(agent.observe())[:, 0])
    env.close()
    agent.close()


@pytest.mark.slow
def test_a_dataset_is_collected_of_its_successes(checkpoint, easy, tmp_path):
    words = [f"checkpoint={checkpoint}", "source=policy", "num_demos=2", "image_size=32", "num_workers=1"]
    config = compose("collect", [*words, "collect.num_envs=4", f"datasets_dir={tmp_path}"])
    summary = collect_dataset(config)
    assert summary.num_episodes == 2 and summary.num_attempts > 2
    assert summary.outcome.startswith("the policy succeeded in ")
    weights = find_demonstrator(str(checkpoint), "PickCube").weights
    assert dataset_folder(config).name == f"level0-mujoco-warp-32px-2demos-ppo-{weights[:8]}"
    contents = [json.loads(path.read_text()) for path in dataset_folder(config).rglob("*.json")]
    assert any(weights in json.dumps(content) for content in contents)
    assert collect_dataset(config).dataset_hash == summary.dataset_hash


@pytest.mark.parametrize(
    ("trained", "requested", "said"),
    [
        (
            ["scenario.physics.decimation=50"],
            [],
            r"at 10 .* 20 were requested.*Add scenario\.physics\.decimation=50",
        ),
        ([], ["scenario.physics.decimation=50"], r"at 20 .* 10 were requested.*Leave out scenario\.physics"),
    ],
)
def test_another_control_rate_than_the_policy_learned_at_is_refused(
    checkpoint, tmp_path, trained, requested, said
):
    run = to_values(compose("train", ["policy=ppo", *trained]))
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(run))
    words = ["source=policy", f"checkpoint={checkpoint}", f"datasets_dir={tmp_path / 'datasets'}"]
    with pytest.raises(ConfigError, match=said):
        collect_dataset(compose("collect", [*words, *requested]))
    assert not (tmp_path / "datasets").exists()


def test_task_defaults_to_that_of_the_checkpoint(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"type": "tdmpc2", "task": "control/cartpole"}))
    words = ["source=policy", f"checkpoint={tmp_path}"]
    assert compose("collect", words).env.task == "control/cartpole"
    assert compose("collect", [*words, "task=StackCube"]).env.task == "StackCube"
    assert compose("collect", ["source=policy", f"checkpoint={tmp_path / 'none'}"]).env.task == "PickCube"


def test_what_cannot_demonstrate_is_named(checkpoint, tmp_path):
    with pytest.raises(ConfigError, match=r"source=policy needs checkpoint=<folder>: that of a run"):
        compose("collect", ["source=policy"])
    with pytest.raises(ConfigError, match=r"checkpoint=runs was given, and source=expert uses no policy"):
        compose("collect", ["checkpoint=runs"])
    with pytest.raises(ConfigError, match=r"path=x was given, and source=policy reads no file"):
        compose("collect", ["source=policy", "checkpoint=runs", "path=x"])
    with pytest.raises(PolicyError, match=r"'ppo' learned the task PickCube, not StackCube"):
        find_demonstrator(str(checkpoint), "StackCube")
    with pytest.raises(PolicyError, match="does not exist"):
        find_demonstrator(str(tmp_path / "none"), "PickCube")
    sees = {"type": "tdmpc2", "observation": {"observation.images.front": 64}}
    (tmp_path / "sees").mkdir()
    (tmp_path / "sees" / "config.json").write_text(json.dumps(sees))
    with pytest.raises(ConfigError, match=r"'tdmpc2' sees the images of front.*policy.observation=state"):
        find_demonstrator(str(tmp_path / "sees"), "PickCube")
    act = tmp_path / "act"
    act.mkdir()
    (act / "config.json").write_text(json.dumps({"type": "act"}))
    with pytest.raises(ConfigError, match=r"'act', which learned from demonstrations itself.*fasttd3, ppo"):
        find_demonstrator(str(act), "PickCube")
