"""The env of what learns by reward."""

import pytest

from envs.errors import ConfigError
from envs.tasks.pick_cube import PickCube
from roboverse_learn.compose import compose
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.reporter import Reporter


@pytest.mark.parametrize("policy", ["ppo", "tdmpc2", "fasttd3"])
def test_a_task_without_reward_is_refused(policy, monkeypatch, tmp_path):
    monkeypatch.setattr(PickCube, "has_reward", False)
    config = compose("train", [f"policy={policy}", "task=PickCube", "simulator=mujoco", "policy.num_envs=2"])
    with pytest.raises(ConfigError, match=f"'PickCube' pays no reward, which policy={policy} learns from"):
        learner_of(policy)(config, tmp_path, "cpu", 0, Reporter())
    assert not any(tmp_path.iterdir())
