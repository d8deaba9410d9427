"""Whether a policy's cameras, sizes and widths are those of the environment, before it is loaded."""

import json
from pathlib import Path
from typing import Any

import pytest

from envs.core.errors import ConfigError
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn.commands.foreign_checkpoint import check_fits as check
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.config.compose import compose

FOLDER = "checkpoints/last/pretrained_model"


def check_fits(checkpoint: Path, *words: str) -> None:
    words = (f"checkpoint={checkpoint}", "preset=quick", "device=cpu", *words)
    tested = checkpoint_to_test(compose("evaluate", words))
    assert tested.checkpoint is not None
    check(tested.checkpoint, tested.env, {})


IMAGE = {"type": "VISUAL", "shape": [3, 96, 96]}
FEATURES = {
    "observation.images.front": IMAGE,
    "observation.images.wrist": IMAGE,
    "observation.state": {"type": "STATE", "shape": [9]},
}


@pytest.fixture
def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns a run whose policy sees two cameras of 96 pixels, and has actions of nine joints."""
    monkeypatch.chdir(tmp_path)
    words = ["policy=act", "preset=quick", "device=cpu", "image_size=96", "cameras=[front,wrist]"]
    with RunFolder.open(compose("train", words), ["roboverse", "train"]) as opened:
        (opened.folder / FOLDER).mkdir(parents=True)
        (opened.folder / FOLDER / WEIGHTS).write_bytes(b"weights")
        write(opened.folder)
        return opened.folder


def write(run: Path, kind: str = "act", **features: Any) -> None:
    """Writes the configuration of a checkpoint, with other features; None takes one away."""
    inputs = {key: value for key, value in {**FEATURES, **features}.items() if value}
    config = {"type": kind, "input_features": inputs, "output_features": {"action": {"shape": [9]}}}
    (run / FOLDER / CONFIG).write_text(json.dumps(config))


def test_a_policy_fits_the_environment_that_it_was_trained_in(whole):
    check_fits(whole)
    check_fits(whole, "task_kwargs.variant=lift")
    check_fits(whole, "robot=iiwa")  # an arm of as many joints, which a warning is about


def test_cameras_that_a_policy_does_not_see_may_be_there(whole):
    write(whole, **{"observation.images.wrist": None})
    check_fits(whole, "cameras=[front,wrist]")
    write(whole, **{"observation.images.front": None, "observation.images.wrist": None})
    check_fits(whole, "cameras=[front,wrist]")


def test_a_policy_without_a_state_and_features_without_their_kind_fit(whole):
    write(whole, **{"observation.state": None, "observation.images.front": {"shape": [3, 96, 96]}})
    check_fits(whole)


def test_an_agent_whose_task_decides_what_it_sees_is_not_checked(whole):
    (whole / FOLDER / CONFIG).write_text(json.dumps({"type": "ppo", "task": "PickCube", "observation": {}}))
    check_fits(whole, "image_size=128")


@pytest.mark.parametrize(
    ("words", "there"),
    [
        (["image_size=128"], "front 128 × 128, wrist 128 × 128"),
        (["cameras=[front]"], "front 96 × 96"),
        (["cameras=[wrist]"], "wrist 96 × 96"),
    ],
)
def test_images_of_other_cameras_or_sizes_are_refused_with_those_of_training(whole, words, there):
    said = (
        rf"images front 96 × 96, wrist 96 × 96 \(height × width\), and those of the evaluation are {there}\."
    )
    with pytest.raises(ConfigError, match=said):
        check_fits(whole, *words)


def test_images_of_another_aspect_are_named_by_both_sides(whole):
    write(whole, **{"observation.images.front": {"type": "VISUAL", "shape": [3, 96, 128]}})
    with pytest.raises(ConfigError, match=r"front 96 × 128, wrist 96 × 96 .* evaluation are front 96 × 96"):
        check_fits(whole)


def test_a_state_of_another_width_alone_is_refused(whole):
    write(whole, **{"observation.state": {"type": "STATE", "shape": [7]}})
    with pytest.raises(ConfigError, match=r"state has 7 numbers, and in PickCube it is 9 \("):
        check_fits(whole)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["robot=ur5e"], r"actions have 9 numbers, and in PickCube it is 8 \(.* of robot ur5e"),
        (["task_kwargs.action_space=hand"], r"actions have 9 numbers, and in PickCube it is \d+ \(.*franka"),
    ],
)
def test_another_number_of_joints_or_another_kind_of_action_is_refused(whole, words, said):
    with pytest.raises(ConfigError, match=rf"{said}.*or train one: roboverse train policy=act task=PickCube"):
        check_fits(whole, *words)


def test_a_policy_that_pads_its_tasks_fits_a_shorter_state_and_no_other_images(whole):
    write(whole, "multitask_act", **{"observation.state": {"type": "STATE", "shape": [12]}})
    check_fits(whole)
    with pytest.raises(ConfigError, match="those of the evaluation are front 128 × 128"):
        check_fits(whole, "image_size=128")
