"""A scene behind LeRobot's ``Robot``, and the teleoperators that act in it."""

import contextlib
import json
import logging
from dataclasses import dataclass

import draccus
import numpy as np
import pytest
import torch
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot.utils.utils import log_say

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.lerobot import RoboVerseExpertConfig, RoboVerseReplayConfig, RoboVerseRobotConfig
from envs.lerobot.robot import joint_key
from envs.spec import EnvSpec
from envs.tasks.plan_following import TAIL_STEPS
from tests.roboverse_learn.data.augmentation.expert_demos import write_demos

JOINTS = [f"joint{i}.pos" for i in range(1, 8)] + ["gripper_finger_joint1.pos", "gripper_finger_joint2.pos"]


def made(folder, **options):
    config = RoboVerseRobotConfig(image_size=32, calibration_dir=folder, **options)
    return make_robot_from_config(config)


@pytest.fixture
def teleoperator(tmp_path):
    """Makes teleoperators that are connected, and disconnects them."""
    with contextlib.ExitStack() as stack:

        def make(config_class, **options):
            teleop = make_teleoperator_from_config(config_class(calibration_dir=tmp_path, **options))
            teleop.connect()
            stack.callback(teleop.disconnect)
            return teleop

        yield make


def steered(robot, teleop, steps):
    """Runs LeRobot's loop for some ticks; returns the actions (T, A)."""
    actions = []
    for _ in range(steps):
        robot.get_observation()
        actions.append(list(robot.send_action(teleop.get_action()).values()))
    return np.array(actions, np.float32)


@pytest.fixture
def robot(tmp_path):
    robot = made(tmp_path, outcomes=str(tmp_path / "outcomes.jsonl"))
    robot.connect()
    yield robot
    if robot.is_connected:
        robot.disconnect()


def test_lerobot_makes_them_by_their_names(tmp_path, teleoperator):
    assert RobotConfig.get_choice_class("roboverse") is RoboVerseRobotConfig
    assert TeleoperatorConfig.get_choice_class("roboverse_expert") is RoboVerseExpertConfig
    assert made(tmp_path).name == "roboverse"
    assert teleoperator(RoboVerseExpertConfig).name == "roboverse_expert"


def test_options_are_read_from_a_command_line():
    @dataclass
    class Command:
        robot: RobotConfig

    given = ["--robot.type=roboverse", "--robot.task=StackCube", "--robot.robot=ur5e", "--robot.level=2"]
    given += ["--robot.cameras=[wrist,front]", "--robot.episodes=[4,17]", "--robot.reset_s=1"]
    given += ["--robot.simulator_settings={impratio: 5.0}"]
    config = draccus.parse(Command, args=given).robot
    assert isinstance(config, RoboVerseRobotConfig)
    assert (config.episodes, config.reset_s, config.split) == ((4, 17), 1.0, "train")
    spec = EnvSpec(task="StackCube", robot="ur5e", level=2, cameras=("wrist", "front"))
    assert config.spec == spec.replace(simulator_settings={"impratio": 5.0})


def test_features_are_known_before_it_connects(tmp_path):
    robot = made(tmp_path, cameras=("front", "wrist"), robot="iiwa")
    assert list(robot.action_features) == [f"joint_{i}.pos" for i in range(1, 8)] + JOINTS[7:]
    images = {name: value for name, value in robot.observation_features.items() if value is not float}
    assert images == {"front": (32, 32, 3), "wrist": (32, 32, 3)} and list(robot.cameras) == list(images)
    with pytest.raises(DeviceNotConnectedError, match="is not connected: call connect"):
        robot.get_observation()


@pytest.mark.slow
def test_the_expert_acts_as_it_does_in_a_collection(robot, tmp_path, teleoperator):
    teleop = teleoperator(RoboVerseExpertConfig)
    first = robot.episode
    assert list(robot.action_features) == JOINTS
    seen = robot.get_observation()
    assert seen["front"].shape == (32, 32, 3) and seen["front"].dtype == np.uint8
    assert list(seen) == [*JOINTS, "front"] and all(isinstance(seen[name], float) for name in JOINTS)
    actions = steered(robot, teleop, 60)
    (expected,) = expert_episodes(robot.env, [first], record=())
    count = expected.length
    assert expected.success and robot.solved_at == expected.solved_at
    np.testing.assert_allclose(actions[:count], expected.actions, atol=1e-6)
    assert (actions[count:] == actions[count - 1]).all()  # the last action is held


@pytest.mark.slow
def test_recorded_actions_solve_their_episodes_one_after_the_other(tmp_path, teleoperator, monkeypatch):
    import datasets

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache")
    demos = write_demos(tmp_path / "demos", "PickCube", 2)
    robot, teleop = made(tmp_path), teleoperator(RoboVerseReplayConfig, path=str(demos))
    robot.connect()
    try:
        for number in range(2):
            actions = steered(robot, teleop, 60)
            recorded = teleop._recorded[number]
            np.testing.assert_array_equal(actions[: len(recorded)], recorded)
            assert robot.solved_at == len(recorded) - TAIL_STEPS
            robot.begin_episode()
        with pytest.raises(ConfigError, match=r"Episode 2 of '.*' was requested, which has 2: 0 to 1\."):
            teleop.get_action()
    finally:
        robot.disconnect()
    other = made(tmp_path, robot="ur5e")
    with pytest.raises(ConfigError, match=r"and the robot's are shoulder_pan_joint\.pos, .*--robot\.robot"):
        other.connect()
    assert not other.is_connected


@pytest.mark.slow
def test_an_announced_episode_is_the_next_of_the_split(robot, tmp_path, teleoperator):
    teleop = teleoperator(RoboVerseExpertConfig)
    split = robot.env.split_indices[:3].tolist()
    logging.getLogger().setLevel(logging.INFO)
    log_say("Recording episode 0", play_sounds=False)
    robot.get_observation()
    assert robot.episode == split[0]  # nothing was done in it yet
    steered(robot, teleop, 60)
    log_say("Reset the environment", play_sounds=False)
    steered(robot, teleop, 2)
    assert robot.episode == split[0]
    log_say("Recording episode 1", play_sounds=False)
    robot.get_observation()
    assert (robot.episode, robot.steps, robot.solved_at) == (split[1], 0, None)
    steered(robot, teleop, 3)
    robot.disconnect()
    log_say("Recording episode 2", play_sounds=False)  # nobody listens any more
    lines = [json.loads(line) for line in (tmp_path / "outcomes.jsonl").read_text().splitlines()]
    assert [(line["episode"], line["steps"], line["success"]) for line in lines] == [
        (split[0], 62, True),
        (split[1], 3, False),
    ]


@pytest.mark.slow
def test_reset_s_begins_the_next_episode_after_success(tmp_path, teleoperator):
    robot = made(tmp_path, reset_s=0.5, episodes=(2, 1))
    robot.connect()
    teleop = teleoperator(RoboVerseExpertConfig)
    try:
        seen = []
        for _ in range(150):
            robot.get_observation()
            robot.send_action(teleop.get_action())
            seen.append((robot.number, robot.episode, robot.solved_at, robot.steps))
    finally:
        robot.disconnect()
    assert [episode for _, episode in sorted({row[:2] for row in seen})] == [2, 1, 2, 1][: seen[-1][0] + 1]
    assert seen[-1][0] >= 2
    for number in range(seen[-1][0]):
        *_, solved_at, steps = [row for row in seen if row[0] == number][-1]
        assert solved_at is not None and steps == solved_at + 10  # half a second at 20 Hz


def test_an_action_that_lacks_a_joint_is_refused(robot):
    action = {name: torch.tensor(0.0) for name in JOINTS[:-1]}
    with pytest.raises(ConfigError, match=r"gripper_finger_joint2\.pos is missing in joint1\.pos"):
        robot.send_action(action)


def test_names_of_a_collected_dataset_and_limits_hold(robot):
    names = [*(f"joint{i}" for i in range(1, 8)), "gripper/finger_joint1", "gripper/finger_joint2"]
    assert [joint_key(name) for name in names] == JOINTS
    sent = robot.send_action(dict.fromkeys(names, 100.0))
    assert sent["gripper_finger_joint1.pos"] == pytest.approx(0.04)
    assert sent["joint1.pos"] == pytest.approx(2.8973)


def test_an_episode_of_the_other_split_is_refused(tmp_path):
    robot = made(tmp_path, episodes=(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12))
    with pytest.raises(ConfigError, match=r"--robot\.episodes=\[.*are not of the train split"):
        robot.connect()
    assert not robot.is_connected


def test_teleoperators_need_a_scene_and_a_dataset(tmp_path, teleoperator):
    with pytest.raises(DeviceNotConnectedError, match=r"acts in a simulated scene\. Give --robot\.type=robo"):
        teleoperator(RoboVerseExpertConfig).get_action()
    with pytest.raises(ConfigError, match=r"needs --teleop\.path=<folder of a dataset>"):
        RoboVerseReplayConfig()
