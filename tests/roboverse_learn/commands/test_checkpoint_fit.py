"""Whether a policy's cameras, sizes and widths are those of the environment, before it is loaded."""

import json
from pathlib import Path

import pytest

from envs.core.errors import ConfigError
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn.commands.foreign_checkpoint import check_fits as check
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.tested_checkpoint import checkpoint_to_test
from roboverse_learn.config.compose import compose


def check_fits(checkpoint: Path, *words: str) -> None:
    words = (f"checkpoint={checkpoint}", "preset=quick", "device=cpu", *words)
    tested = checkpoint_to_test(compose("evaluate", words))
    assert tested.checkpoint is not None
    check(tested.checkpoint, tested.env, {})


@pytest.fixture
def whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns a run whose policy sees two cameras of 96 pixels, and has actions of nine joints."""
    monkeypatch.chdir(tmp_path)
    image = {"type": "VISUAL", "shape": [3, 96, 96]}
    features = {f"observation.images.{name}": image for name in ("front", "wrist")}
    features["observation.state"] = {"type": "STATE", "shape": [9]}
    config = {"type": "act", "input_features": features, "output_features": {"action": {"shape": [9]}}}
    words = ["policy=act", "preset=quick", "device=cpu", "image_size=96", "cameras=[front,wrist]"]
    with RunFolder.open(compose("train", words), ["roboverse", "train"]) as opened:
        folder = opened.folder / "checkpoints/last/pretrained_model"
        folder.mkdir(parents=True)
        (folder / CONFIG).write_text(json.dumps(config))
        (folder / WEIGHTS).write_bytes(b"weights")
        return opened.folder


def test_a_policy_fits_the_environment_that_it_was_trained_in_also_with_further_cameras(whole):
    check_fits(whole)
    check_fits(whole, "task_kwargs.variant=lift")
    check_fits(whole, "robot=iiwa")  # an arm of as many joints, which a warning is about


@pytest.mark.parametrize("words", [["image_size=128"], ["cameras=[front]"], ["cameras=[wrist]"]])
def test_images_of_other_cameras_or_sizes_are_refused_with_those_of_training(whole, words):
    said = r"trained with cameras=\[front,wrist\] image_size=96, and the evaluation has cameras=\["
    given = r"image_size=(96|128)\. Leave both out"
    with pytest.raises(ConfigError, match=rf"{said}.*{given}"):
        check_fits(whole, *words)


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


def test_a_policy_that_pads_its_tasks_fits_a_shorter_state(whole):
    path = whole / "checkpoints/last/pretrained_model" / CONFIG
    config = json.loads(path.read_text())
    config["type"] = "multitask_act"
    config["input_features"]["observation.state"]["shape"] = [12]
    path.write_text(json.dumps(config))
    check_fits(whole)
