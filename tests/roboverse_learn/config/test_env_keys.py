"""Keys of the environment on the command line: settings of a simulator and changes of the scene."""

import json

import pytest
import yaml

from envs.core.errors import ConfigError, UnknownNameError
from envs.core.json_values import to_json_values
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands.run_identity import identity, run_name
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import from_values, to_values
from roboverse_learn.data.sources import SOURCES

REQUIRED = {"evaluate": ["checkpoint=runs/x"]}


@pytest.mark.parametrize("command", ["collect", "train", "evaluate"])
def test_settings_of_a_simulator_pass_through(command: str) -> None:
    words = [*REQUIRED.get(command, []), "simulator=mujoco_warp", "simulator_settings.njmax=768"]
    config = compose(command, words)
    assert to_json_values(config.env)["simulator_settings"] == {"njmax": 768}
    assert from_values(command, yaml.safe_load(yaml.safe_dump(to_values(config)))) == config


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["simulator=mujoco_warp", "simulator_settings.njmx=9"], UnknownNameError, "Did you mean 'njmax'"),
        (["simulator_settings.njmax=9"], UnknownNameError, "setting of simulator=mujoco 'njmax'"),
        (["simulator_settings.cone=round"], UnknownNameError, "cone of mujoco 'round'"),
        (
            ["simulator=mujoco_warp", "simulator_settings.njmax=many"],
            ConfigError,
            r"simulator_settings\.njmax: input should be a valid integer, .* given 'many'",
        ),
        (
            ["simulator=mujoco_warp", "simulator_settings.nconmax=0"],
            ConfigError,
            "nconmax must be at least 1, given 0",
        ),
    ],
)
def test_wrong_simulator_setting_is_refused_before_launch(words, error, message) -> None:
    with pytest.raises(error, match=message):
        compose("collect", words)


@pytest.mark.parametrize("command", ["collect", "train", "evaluate"])
def test_keys_of_the_scene_pass_through(command: str) -> None:
    words = [
        "scenario.cameras.front.pos=[1,0,0.5]",
        "scenario.lighting.array_shape=[3,4]",
        "scenario.physics.decimation=50",
    ]
    words += [
        "scenario.cameras.wrist.fovy_deg=50",
        "scenario.room=null",
        "scenario.appearance.lights.0.intensity=0.5",
    ]
    config = compose(command, [*REQUIRED.get(command, []), *words, "cameras=[wrist]"])
    assert to_json_values(config.env)["scenario"] == {
        "cameras": {"front": {"pos": [1, 0, 0.5]}, "wrist": {"fovy_deg": 50}},
        "lighting": {"array_shape": [3, 4]},
        "physics": {"decimation": 50},
        "room": None,
        "appearance": {"lights": {"0": {"intensity": 0.5}}},
    }
    assert to_json_values(config.env)["cameras"] == ["wrist"]
    assert from_values(command, yaml.safe_load(yaml.safe_dump(to_values(config)))) == config


@pytest.mark.parametrize(
    ("word", "error", "message"),
    [
        ("scenario.physics.decimaton=5", UnknownNameError, r"scenario\.physics 'decimaton'.*'decimation'"),
        ("decimation=5", UnknownNameError, r"Did you mean 'scenario\.physics\.decimation'"),
        (
            "scenario.cameras.frnt.fovy_deg=5",
            UnknownNameError,
            r"key of scenario\.cameras 'frnt'.*Did you mean 'front'",
        ),
        (
            "scenario.lighting.array_shape=[0,3]",
            ConfigError,
            r"array_shape is two positive counts, given \(0, 3\)",
        ),
        (
            "scenario.physics.decimation=x",
            ConfigError,
            r"scenario\.physics\.decimation: input should be .* given 'x'",
        ),
        (
            "scenario.cameras.front.width=64",
            ConfigError,
            r"front\.width=64 was given; .* are image_size=<pixels>",
        ),
        (
            "scenario=3",
            ConfigError,
            r"'scenario' has keys of its own: .* in scenario\.physics\.decimation",
        ),
        (
            "task_kwargs=3",
            ConfigError,
            r"'task_kwargs' has keys of its own: .* in task_kwargs\.variant=lift",
        ),
        (
            "scenario.physics=3",
            ConfigError,
            r"scenario\.physics has keys of its own \(timestep_s, .*; given 3",
        ),
        ("fovy_deg=3", UnknownNameError, r"Did you mean 'scenario\.cameras\.<name>\.fovy_deg'"),
        ("front.fovy_deg=3", UnknownNameError, r"Did you mean 'scenario\.cameras\.<name>\.fovy_deg'"),
        ("scenario..physics=3", ConfigError, r"'scenario\.\.physics=3' is not key=value"),
    ],
)
def test_wrong_scene_key_is_refused_before_launch(word, error, message) -> None:
    with pytest.raises(error, match=message):
        compose("collect", [word])


@pytest.mark.parametrize(
    ("words", "others"),
    [
        (
            ["scenario.physics.decimation=25", "scenario.cameras={}", "scenario.physics.gravity=[0,0,-9.81]"],
            [],
        ),  # as it is
        (["scenario.cameras.front.fovy_deg=40.0"], ["scenario.cameras.front={fovy_deg:40}"]),
        (["scenario.room=null"], ["scenario.room=null", "scenario.physics={}"]),
    ],
)
def test_one_change_is_the_same_however_it_is_written(words: list[str], others: list[str]) -> None:
    one, other = (json.dumps(to_values(compose("collect", each))) for each in (words, others))
    assert one == other


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["robot=ur5"], UnknownNameError, r"Unknown robot 'ur5'\. Did you mean 'ur5e'"),
        (["robot=panda"], UnknownNameError, r"Unknown robot 'panda'\. Did you mean 'franka'"),
        (["robot=ant"], ConfigError, "'ant' cannot do PickCube: it is no arm with a gripper"),
        (["task=control/cartpole", "robot=ur5e"], ConfigError, "'cartpole', and takes no other"),
    ],
)
def test_a_robot_that_cannot_do_the_task_is_refused_before_launch(words, error, message) -> None:
    with pytest.raises(error, match=message):
        compose("collect", words)


def test_the_tasks_own_robot_is_no_other_dataset_and_another_robot_is() -> None:
    own, usual, other = (compose("collect", words) for words in (["robot=franka"], [], ["robot=ur5e"]))
    assert own == usual and dataset_folder(own) == dataset_folder(usual)
    assert dataset_folder(other).name == f"{dataset_folder(usual).name}-robot=ur5e"
    assert "robot" not in SOURCES.get("expert")(usual).settings()
    assert SOURCES.get("expert")(other).settings()["robot"] == "ur5e"


def test_a_run_without_another_robot_keeps_its_name() -> None:
    usual, other = compose("train", []), compose("train", ["robot=ur5e"])
    assert "robot" not in identity(usual) and identity(other)["robot"] == "ur5e"
    assert run_name(usual) != run_name(other)


def test_a_parameter_with_its_default_is_no_change() -> None:
    words = ["task_kwargs.cube_half_size_m=0.02", "task_kwargs.variant=goal"]
    assert compose("collect", words) == compose("collect", [])
    changed = compose("collect", ["task=CloseBox", "task_kwargs.spawn_x_m=[0.45,0.6]"])
    assert changed.env.task_kwargs == {"spawn_x_m": [0.45, 0.6]}
