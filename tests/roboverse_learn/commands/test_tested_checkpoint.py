"""What is evaluated: how a checkpoint finds its run, and that no two evaluations share a results file."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from benchmark import results
from envs.core.errors import ConfigError, PolicyError, UnknownNameError
from policies.checkpoint import CONFIG, WEIGHTS, write_hashes
from roboverse_learn.commands.run_folder import RunFolder, step_of
from roboverse_learn.commands.tested_checkpoint import (
    TestedCheckpoint,
    checkpoint_to_test,
    protocol_of,
)
from roboverse_learn.config.compose import compose

ACT = {
    "type": "act",
    "input_features": {
        "observation.images.front": {"type": "VISUAL", "shape": [3, 128, 128]},
        "observation.state": {"type": "STATE", "shape": [9]},
    },
}


def write_checkpoint(folder: Path, config: dict[str, Any] | None = None, weights: bytes = b"weights") -> Path:
    """Writes the two files that a tested looks at; nothing is loaded from them."""
    folder.mkdir(parents=True)
    (folder / CONFIG).write_text(json.dumps(ACT if config is None else config))
    (folder / WEIGHTS).write_bytes(weights)
    return folder


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns a run with two checkpoints, 100 and 200 steps old."""
    monkeypatch.chdir(tmp_path)
    config = compose(
        "train", ["policy=act", "preset=quick", "level=2", "seed=5", "device=cpu", "image_size=96"]
    )
    with RunFolder.open(config, ["roboverse", "train"]) as opened:
        with opened.stage("collect") as facts:
            facts.update(dataset_hash="0" * 64, num_episodes=400)
        for step in (100, 200):
            write_checkpoint(opened.folder / f"checkpoints/{step:06d}/pretrained_model")
        (opened.folder / "checkpoints/last").symlink_to("000200")
        return opened.folder


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(4):
        Image.new("RGB", (16, 16), (60 * number, 100, 200)).save(folder / f"{number}.png")
    return folder


def to_test(checkpoint: Path, *words: str) -> TestedCheckpoint:
    return checkpoint_to_test(
        compose("evaluate", [f"checkpoint={checkpoint}", "preset=quick", "device=cpu", *words])
    )


def test_checkpoint_is_identified_by_its_run(run: Path) -> None:
    found = to_test(run)
    assert found.run == run.name
    assert (found.env.task, found.env.simulator, found.env.renderer, found.env.image_size) == (
        *("PickCube", "mujoco", "warp"),
        96,
    )
    assert (found.training.level, found.training.only, found.training.seed) == (2, None, 5)
    assert (found.training.dataset_hash, found.training.demonstrations) == ("0" * 64, 400)
    assert step_of(found.checkpoint) == 200
    assert found.config["run"]["level"] == 2


FOLDERS = ["my run", "r[1]", "läuft", "名前", "-lead", "_best", ".hidden", "x" * 200]


def fits_a_result(name: str) -> bool:
    """Whether the schema of results takes a name."""
    schema = json.loads((Path(results.__file__).parent / "schema/result.v2.json").read_text())["$defs"][
        "name"
    ]
    return bool(re.search(schema["pattern"], name)) and len(name) <= schema["maxLength"]


def test_a_run_in_a_folder_of_any_name_has_a_result_of_a_name_that_is_valid(run: Path) -> None:
    names = []
    for folder in (*FOLDERS, "my-run", "my  run"):
        run = run.rename(run.with_name(folder))
        names.append(to_test(run).run)
    assert [name for name in names if not fits_a_result(name)] == []
    assert len(set(names)) == len(names), "two runs share a results file"
    assert names[FOLDERS.index("my run")].startswith("my-run-") and "my-run" in names


@pytest.mark.parametrize("folder", FOLDERS[:-1])
def test_a_checkpoint_without_a_run_in_a_folder_of_any_name_has_a_valid_name(
    tmp_path: Path, folder: str
) -> None:
    checkpoint = write_checkpoint(tmp_path / folder / "pretrained_model")
    assert fits_a_result(to_test(checkpoint, "task=PickCube").run)


def test_a_run_of_a_gpu_is_evaluated_where_there_is_none(run: Path) -> None:
    config = run / "config.yaml"
    config.write_text(config.read_text().replace("device: cpu", "device: cuda:7"))
    assert "device: cuda:7" in config.read_text()
    assert to_test(run).device == "cpu"


def test_run_folder_means_its_last_checkpoint(run: Path) -> None:
    last = run / "checkpoints/000200/pretrained_model"
    assert to_test(run).checkpoint.resolve() == to_test(last).checkpoint.resolve() == last.resolve()
    assert to_test(run).run == to_test(last).run


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["renderer=gl"],
        ["image_size=64"],
        ["task_kwargs.variant=lift"],
        ["simulator_settings.impratio=5"],
        ["scenario.cameras.front.fovy_deg=30"],
        ["levels=[0]"],
        ["episodes=7"],
        ["splits=[train]"],
        ["alone=[camera]"],
        ["protocol_seed=1"],
    ],
    ids=" ".join,
)
def test_different_evaluations_have_different_results_files(run: Path, words: list[str]) -> None:
    changed = to_test(run, *words).run
    assert changed != run.name and changed.startswith(f"{run.name}-")
    assert Path(changed).name == changed  # it is the name of a file


def test_other_materials_have_a_results_file_of_their_own(run: Path, images: Path) -> None:
    name = to_test(run, f"materials=+{images}").run
    assert re.fullmatch(rf"{run.name}-\+images-[0-9a-f]{{8}}", name)
    assert name != to_test(run, f"materials={images}").run
    (images / "0.png").write_bytes((images / "1.png").read_bytes())
    assert to_test(run, f"materials=+{images}").run != name


@pytest.mark.parametrize(
    "word",
    [
        "task_kwargs.variant=lift",
        "simulator=newton",
        "simulator_settings.impratio=5",
        "renderer=gl",
        "scenario.room=null",
    ],
)
def test_another_scene_of_a_checkpoint_without_a_run_is_in_its_name(tmp_path: Path, word: str) -> None:
    folder = write_checkpoint(tmp_path / "their run/model")
    usual, other = (to_test(folder, "task=PickCube", *words).run for words in ([], [word]))
    assert other.startswith(f"{usual}-") and Path(other).name == other


@pytest.mark.parametrize("word", ["image_size=64", "cameras=[wrist]"])
@pytest.mark.parametrize("policy", ["act", "smolvla"])
def test_other_images_of_a_checkpoint_without_a_run_are_in_its_name(
    tmp_path: Path, word: str, policy: str
) -> None:
    folder = write_checkpoint(tmp_path / "their run/model", {**ACT, "type": policy})
    usual, same, other = (
        to_test(folder, "task=PickCube", *words).run for words in ([], ["image_size=128"], [word])
    )
    assert usual == same and other.startswith(f"{usual}-") and Path(other).name == other


def test_other_materials_of_a_checkpoint_without_a_run_are_in_its_name(tmp_path: Path, images: Path) -> None:
    folder = write_checkpoint(tmp_path / "their run/model")
    usual, other = (to_test(folder, "task=PickCube", *w).run for w in ([], [f"materials={images}"]))
    assert other.startswith(f"{usual}-images-")


def test_settings_of_a_simulator_are_checked_against_that_of_the_demonstrations(run: Path) -> None:
    assert to_test(run, "simulator_settings.impratio=5").env.simulator_settings == {"impratio": 5}
    with pytest.raises(UnknownNameError, match=r"setting of simulator=mujoco 'impratoi'.*'impratio'"):
        to_test(run, "simulator_settings.impratoi=5")


@pytest.fixture
def slow_run(run: Path) -> Path:
    """Returns a run whose demonstrations were made at 10 Hz, and not at 20."""
    values = yaml.safe_load((run / "config.yaml").read_text())
    values["scenario"] = {"physics": {"decimation": 50}, "room": None}
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    return run


def test_the_scene_of_the_demonstrations_is_that_of_the_evaluation(slow_run: Path) -> None:
    found = to_test(slow_run)
    assert found.env.scenario == {"physics": {"decimation": 50}, "room": None}
    assert found.run == slow_run.name


def test_evaluation_overrides_have_precedence(slow_run: Path, caplog: pytest.LogCaptureFixture) -> None:
    found = to_test(slow_run, "scenario.cameras.front.fovy_deg=30")
    assert found.env.scenario["physics"] == {"decimation": 50}
    assert found.env.scenario["cameras"] == {"front": {"fovy_deg": 30}}
    assert found.run.startswith(f"{slow_run.name}-scenario-")
    assert not caplog.records


def test_a_light_of_the_demonstrations_can_be_changed_for_an_evaluation(run: Path) -> None:
    values = yaml.safe_load((run / "config.yaml").read_text())
    values["scenario"] = {"appearance": {"lights": [{"intensity": 0.25}, {"kind": "area"}]}}
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    first, second = to_test(run, "scenario.appearance.lights.1.intensity=0.5").env.scenario["appearance"][
        "lights"
    ]
    assert (first["intensity"], second["kind"], second["intensity"]) == (0.25, "area", 0.5)


def test_different_control_rate_warns(slow_run: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert to_test(slow_run, "scenario.physics.decimation=25").env.scenario == {
        "room": None
    }  # the task's own
    assert "learned at 10 control steps per second and is evaluated at 20. Leave out scenario" in caplog.text


def test_another_task_has_a_control_rate_of_its_own(run: Path, caplog: pytest.LogCaptureFixture) -> None:
    to_test(run, "task=calvin/D/open_drawer", "other_tasks=true")
    assert "at 30. calvin/D/open_drawer, which it did not learn, has that rate" in caplog.text


@pytest.mark.parametrize(
    ("trained", "evaluated", "warns"),
    [
        ({}, "iiwa", True),
        ({"task_kwargs": {"action_space": "hand"}}, "iiwa", False),
        ({}, "franka", False),
        ({"dataset": "of_an_iiwa"}, "iiwa", False),
    ],
)
def test_joints_of_another_robot_warn(
    run: Path, caplog: pytest.LogCaptureFixture, trained: dict[str, Any], evaluated: str, warns: bool
) -> None:
    values = yaml.safe_load((run / "config.yaml").read_text())
    (run / "config.yaml").write_text(yaml.safe_dump(values | trained))
    assert to_test(run, f"robot={evaluated}").env.robot == evaluated
    said = "The policy learned joints of 'franka' and moves those of 'iiwa'"
    assert (said in caplog.text) == warns == bool(caplog.records)


def test_unknown_camera_of_the_demonstrations_is_refused(run: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"key of scenario\.cameras 'fromt'.*Did you mean 'front'"):
        to_test(run, "scenario.cameras.fromt.fovy_deg=30")


@pytest.mark.parametrize("words", [["num_envs=3"], ["videos=0"], ["results_dir=elsewhere"]], ids=" ".join)
def test_what_decides_no_episode_does_not_change_the_name(run: Path, words: list[str]) -> None:
    assert to_test(run, *words).run == run.name


def test_an_earlier_checkpoint_has_a_results_file_of_its_own(run: Path) -> None:
    earlier = to_test(run / "checkpoints/000100")
    assert earlier.run == f"{run.name}-step100"
    assert step_of(earlier.checkpoint) == 100


def test_a_last_checkpoint_that_was_copied_as_a_folder_has_the_step_of_its_weights(run: Path) -> None:
    checkpoints = run / "checkpoints"
    (checkpoints / "last").unlink()
    write_checkpoint(checkpoints / "last/pretrained_model", weights=b"of step 100")
    assert step_of(to_test(run).checkpoint) is None, "there are no hashes"
    for name, weights in (("last", b"of step 100"), ("000100", b"of step 100"), ("000200", b"others")):
        (checkpoints / name / "pretrained_model" / WEIGHTS).write_bytes(weights)
        write_hashes(checkpoints / name / "pretrained_model")
    assert step_of(to_test(run).checkpoint) == 100
    (checkpoints / "000100/pretrained_model/sha256.json").unlink()
    assert step_of(to_test(run).checkpoint) is None


def test_a_checkpoint_without_a_run_names_its_images(tmp_path: Path) -> None:
    found = to_test(write_checkpoint(tmp_path / "their run/model"), "task=PickCube")
    assert (found.env.image_size, found.env.simulator, found.env.renderer) == (128, "mujoco", "warp")
    assert (found.training.level, found.training.dataset_hash, found.training.demonstrations) == (
        None,
        None,
        None,
    )
    assert found.run.startswith("their-run-")


@pytest.mark.parametrize("name", ["ppo", "fasttd3", "tdmpc2"])
def test_an_agent_without_a_run_sees_no_images(tmp_path: Path, name: str) -> None:
    content = {"type": name, "config": {}, "observation": {"observation.environment_state": 51}}
    folder = write_checkpoint(tmp_path / "their run/model", content)
    found = to_test(folder, "task=humanoid/walk", "simulator=newton")
    assert (found.env.task, found.env.simulator, found.env.cameras) == ("humanoid/walk", "newton", ())
    assert found.env.image_size == 256


def test_an_agent_without_a_run_names_its_cameras(tmp_path: Path) -> None:
    seen = {"observation.images.wrist": 64, "observation.images.front": 64}
    folder = write_checkpoint(tmp_path / "model", {"type": "tdmpc2", "config": {}, "observation": seen})
    found = to_test(folder, "task=PickCube")
    assert (found.env.cameras, found.env.image_size) == (("wrist", "front"), 64)


def test_two_checkpoints_without_a_run_do_not_share_a_results_file(tmp_path: Path) -> None:
    names = {
        to_test(write_checkpoint(tmp_path / str(n) / "run/model", weights=bytes([n])), "task=PickCube").run
        for n in range(3)
    }
    assert len(names) == 3


def test_a_checkpoint_without_a_run_needs_a_task(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"is in no run folder.*add task=<name>"):
        to_test(write_checkpoint(tmp_path / "model"))


def test_images_of_two_sizes_need_a_word(tmp_path: Path) -> None:
    images = ACT["input_features"] | {
        "observation.images.wrist": {"type": "VISUAL", "shape": [3, 64, 64]},
    }
    folder = write_checkpoint(tmp_path / "model", ACT | {"input_features": images})
    with pytest.raises(ConfigError, match=r"sizes \[64, 128\]: add image_size=<pixels>"):
        to_test(folder, "task=PickCube")
    assert to_test(folder, "task=PickCube", "image_size=64").env.image_size == 64


def _drop(name: str) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).unlink()


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_drop(WEIGHTS), f"has no {WEIGHTS}"),
        (_drop(CONFIG), f"has no {CONFIG}"),
        (lambda folder: (folder / CONFIG).write_text('{"type": "x"}'), "Unknown policy 'x'. Valid: act"),
        (lambda folder: (folder / CONFIG).write_text('{"type": "act"}'), "does not say which images"),
        (lambda folder: (folder / CONFIG).write_text("[]"), CONFIG),
    ],
    ids=["no-weights", "no-config", "unknown-policy", "no-features", "a-list"],
)
def test_a_broken_checkpoint_is_named_before_anything_starts(
    tmp_path: Path, damage: Callable[[Path], Any], said: str
) -> None:
    folder = write_checkpoint(tmp_path / "model")
    damage(folder)
    with pytest.raises(PolicyError) as error:
        to_test(folder, "task=PickCube")
    assert said in str(error.value) and str(folder) in str(error.value)


@pytest.mark.parametrize("name", [CONFIG, "config.yaml"])
def test_a_policy_of_another_package_says_how_it_is_made_known(run: Path, name: str) -> None:
    path = run / name if name != CONFIG else run / "checkpoints/last/pretrained_model" / name
    path.write_text(re.sub(r"\bact\b", "my_cnn", path.read_text(), count=1))
    with pytest.raises((PolicyError, UnknownNameError), match=r"policy 'my_cnn'.* plugins=\[<package>\]"):
        to_test(run)


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="nowhere' does not exist"):
        to_test(tmp_path / "nowhere")


def test_the_protocol_follows_from_the_words() -> None:
    config = compose(
        "evaluate", ["checkpoint=x", "levels=[0,3]", "alone=[camera]", "splits=[test]", "episodes=7"]
    )
    cells = [str(cell) for cell in protocol_of(config.evaluate).cells()]
    assert cells == ["level 0, test split", "level 3, test split", "camera alone, test split"]


def test_a_run_of_reinforcement_learning_has_no_validation_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with RunFolder.open(compose("train", ["policy=ppo", "device=cpu"]), ["roboverse", "train"]) as opened:
        write_checkpoint(opened.folder / "checkpoints/000100/pretrained_model")
        (opened.folder / "checkpoints/last").symlink_to("000100")
    to_test(opened.folder, "splits=[train]")
    with pytest.raises(ConfigError, match="policy=ppo learns from every episode of the train split"):
        to_test(opened.folder, "splits=[validation]")
