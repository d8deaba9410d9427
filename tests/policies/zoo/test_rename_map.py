"""``rename_map``: cameras of the task by the names that the policy has for them."""

import json
import re
from pathlib import Path

import pytest

from envs.core.errors import PolicyError, UnknownNameError
from policies.zoo import preflight
from tests.policies.zoo.foreign import check, evaluate, image, smolvla_base

CAMERAS = "cameras=[front,wrist]"


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    return smolvla_base(tmp_path / "smolvla_base")


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the packages of the extra were."""
    monkeypatch.setattr(preflight, "find_spec", lambda name: name)


def rename_cameras(checkpoint: Path, **names: str) -> None:
    """Gives the cameras of a checkpoint other names."""
    config = json.loads((checkpoint / "config.json").read_text())
    features = config["input_features"]
    for before, after in names.items():
        features[f"observation.images.{after}"] = features.pop(f"observation.images.{before}")
    (checkpoint / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("frnt:camera1", "Unknown camera of PickCube 'frnt'. Did you mean 'front'?"),
        (
            "front:camera1,wrist:camra2",
            "Unknown camera of the policy 'smolvla' 'camra2'. Did you mean 'camera2'?",
        ),
    ],
)
def test_a_map_names_cameras_of_the_task_and_of_the_policy(foreign, given: str, message: str):
    with pytest.raises(UnknownNameError, match=re.escape(message)):
        evaluate(foreign, "task=PickCube", f"rename_map={{{given}}}")


def test_a_map_may_have_lerobots_whole_keys_and_name_a_camera_that_stays_empty(foreign):
    config = json.loads((foreign / "config.json").read_text())
    config["input_features"]["observation.images.empty_camera_0"] = image(256)
    (foreign / "config.json").write_text(json.dumps(config))
    keys = '{"observation.images.front": "observation.images.camera1", "wrist": "empty_camera_0"}'
    assert evaluate(foreign, "task=PickCube", f"rename_map={keys}").env.cameras == ("front",)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("frnt:camera1", "Unknown camera of the dataset 'frnt'. Did you mean 'front'?"),
        (
            "front:camera1,wrist:camra2",
            "Unknown camera of the policy 'smolvla' 'camra2'. Did you mean 'camera2'?",
        ),
    ],
)
def test_training_refuses_a_name_that_is_no_camera(foreign, given: str, message: str, installed):
    with pytest.raises(UnknownNameError, match=re.escape(message)):
        check(f"policy.path={foreign}", CAMERAS, f"rename_map={{{given}}}")
    check(f"policy.path={foreign}", CAMERAS, "rename_map={front:camera1,wrist:camera2}")


def test_a_policy_that_is_trained_from_the_start_takes_any_name_for_a_camera_of_the_dataset(installed):
    check("type=smolvla", CAMERAS, "rename_map={front:eye}")
    with pytest.raises(UnknownNameError, match="Unknown camera of the dataset 'frnt'"):
        check("type=smolvla", CAMERAS, "rename_map={frnt:eye}")
    with pytest.raises(PolicyError, match="front and wrist of the dataset are both wrist of the policy"):
        check("type=smolvla", CAMERAS, "rename_map={front:wrist}")


def test_two_cameras_of_one_name_are_refused(foreign, installed):
    rename_cameras(foreign, camera1="front", camera2="wrist")
    said = "gives two cameras the same name: front and wrist of %s are both wrist of the policy"
    with pytest.raises(PolicyError, match=said % "the dataset"):
        check(f"policy.path={foreign}", CAMERAS, "rename_map={front:wrist}")
    with pytest.raises(PolicyError, match=said % "PickCube"):
        evaluate(foreign, "task=PickCube", "rename_map={front:wrist}")
    for words in (["rename_map={front:wrist,wrist:front}"], ["rename_map={front:wrist}", "cameras=[front]"]):
        check(f"policy.path={foreign}", CAMERAS, *words)
        assert evaluate(foreign, "task=PickCube", *words).rename_map["front"] == "wrist"


def test_two_cameras_of_one_name_are_refused_before_a_checkpoint_of_a_run_is_loaded(foreign):
    from dataclasses import replace

    from roboverse_learn.commands.foreign_checkpoint import check_fits

    rename_cameras(foreign, camera1="front", camera2="wrist")
    tested = evaluate(foreign, "task=PickCube")
    with pytest.raises(PolicyError, match="front and wrist of PickCube are both wrist of the policy"):
        check_fits(tested.checkpoint, replace(tested.env, cameras=("front", "wrist")), {"front": "wrist"})
