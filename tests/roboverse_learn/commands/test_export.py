"""``roboverse export``: what it refuses."""

import re
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, PolicyError
from envs.scenario import CameraCfg
from envs.tasks.make import make_task
from roboverse_learn import export
from roboverse_learn.cli import main

FRONT = CameraCfg(name="front", pos=(1.0, 0.0, 1.0), look_at=(0.0, 0.0, 0.0), width=86, height=64)
STATE, ACTION = {"shape": [6]}, {"action": {"shape": [6]}}


def refused(words, capsys):
    assert main(["export", *words]) == 2
    return capsys.readouterr().err


def test_a_checkpoint_must_be_named_and_exist(capsys, tmp_path):
    assert "Name what to export" in refused([], capsys)
    assert "does not exist" in refused([f"checkpoint={tmp_path / 'none'}"], capsys)


@pytest.mark.parametrize(
    ("to", "meant"), [("so101_folower", "so101_follower"), ("so101", "so101_follower"), ("banana", "")]
)
def test_an_unknown_robot_is_refused_before_a_checkpoint_is_looked_for(capsys, tmp_path, to, meant):
    said = refused([f"to={to}", f"checkpoint={tmp_path / 'none'}"], capsys)
    hint = f" Did you mean '{meant}'?" if meant else ""
    assert f"Unknown robot to={to}.{hint} Valid: so101_follower, the robots of LeRobot's" in said


def test_a_checkpoint_of_no_run_is_refused(capsys, tmp_path):
    (tmp_path / "config.json").write_text("{}")
    assert "in no run of roboverse train" in refused([f"checkpoint={tmp_path}"], capsys)


def test_a_task_of_another_robot_is_refused():
    with pytest.raises(ConfigError, match="acts with 'franka' in PickCube, which is no robot of LeRobot's"):
        export._checked_robot(make_task("PickCube"), "so101_follower")
    with pytest.raises(ConfigError, match="is LeRobot's 'so101_follower', not 'koch_follower'"):
        export._checked_robot(make_task("so101/pick_cube"), "koch_follower")


def test_several_robots_are_refused():
    with pytest.raises(ConfigError, match="roboverse export"):
        export._checked_robot(make_task("TwoRobotPickCube"), "so101_follower")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"type": "ppo"}, "is no policy of LeRobot's format"),
        (
            {"input_features": {"observation.state": {"shape": [9]}}, "output_features": ACTION},
            "has a state of (9,) and an action of (6,) numbers; 'so101' has 6 joints",
        ),
        (
            {
                "input_features": {
                    "observation.state": STATE,
                    "observation.images.front": {"shape": [3, 96, 128]},
                },
                "output_features": ACTION,
            },
            "All must be of one size",
        ),
    ],
    ids=["agent", "joints", "images"],
)
def test_a_policy_that_does_not_fit_the_robot_is_refused(content, said):
    robot = make_task("so101/pick_cube").robot
    with pytest.raises(PolicyError, match=re.escape(said)):
        export._checked_features(Path("checkpoint"), content, robot, (FRONT,))


def test_the_size_is_that_of_the_images_and_none_for_a_policy_without_any():
    robot = make_task("so101/pick_cube").robot
    blind = {"input_features": {"observation.state": STATE}, "output_features": ACTION}
    assert export._checked_features(Path("checkpoint"), blind, robot, (FRONT,)) is None
    blind["input_features"]["observation.images.front"] = {"shape": [3, 64, 86]}
    assert export._checked_features(Path("checkpoint"), blind, robot, (FRONT,)) == (64, 86)
