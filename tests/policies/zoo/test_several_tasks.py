"""One policy of LeRobot's registry that learns several tasks."""

import pytest

from benchmark.results import read_result
from envs.core.errors import ConfigError
from roboverse_learn import cli
from roboverse_learn.commands.run_identity import identity
from roboverse_learn.config.compose import compose
from roboverse_learn.evaluate import evaluate_all
from roboverse_learn.training.learners import learner_of
from tests.policies.zoo.tiny import VQBET

LIST = "task=[PickCube,StackCube]"
WORDS = (
    *("policy=lerobot", "type=vqbet", "preset=quick", "image_size=32", "device=cpu", "slow_ok=true"),
    *("cameras=[front]", "num_demos=2", "collect.num_workers=1", "collect.num_envs=2", "train.steps=2"),
    *("batch_size=4", "save_every=2", "log_every=1", "train.num_threads=1", "evaluate.num_envs=1"),
    *("levels=[0]", "splits=[test]", "episodes=1", "videos=0"),
    *(f"policy.{key}={str(value).lower()}".replace("none", "null") for key, value in VQBET.items()),
)


@pytest.mark.parametrize("policy", [["policy=lerobot", "type=vqbet"], ["policy=openvla"], ["policy=octo"]])
def test_a_list_of_tasks_is_the_first_and_those_that_are_learned_with_it(policy):
    config = compose("train", [*policy, LIST])
    assert config.tasks == ("PickCube", "StackCube") and config.policy.tasks == ("StackCube",)
    assert "policy.tasks" not in identity(compose("train", [*policy, "task=PickCube"]))


def test_tasks_of_another_width_are_refused_and_a_policy_that_pads_takes_them():
    words = ["task=[PickCube,TwoRobotPickCube]", "cameras=[front]", "image_size=64"]
    with pytest.raises(
        ConfigError, match=r"PickCube has 9 numbers of state and 9 of action, TwoRobotPickCub"
    ):
        learner_of(compose("train", ["policy=lerobot", "type=vqbet", *words]), "cpu").check()
    learner_of(compose("train", ["policy=mtact", *words]), "cpu").check()


@pytest.mark.slow
def test_one_command_trains_and_evaluates_each_task(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", LIST, "run=both", *WORDS]) == 0, capsys.readouterr().err
    for task in ("PickCube", "StackCube"):
        result = read_result(tmp_path / "results/v2" / task / "vqbet" / "both.json")
        assert result.train_tasks == ("PickCube", "StackCube") and result.demonstrations == 4
    again = compose("evaluate", ["checkpoint=both", "levels=[0]", "splits=[test]", "episodes=2", "videos=0"])
    assert [each.result.env.task for each in evaluate_all(again)] == ["PickCube", "StackCube"]
