"""Whose demonstrations a checkpoint learned, where its run has ``dataset=``, or where it is of no run."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from envs.core.atomic import write_json
from envs.spec import EnvSpec
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn.commands import learned_robots
from roboverse_learn.commands.learned_robots import (
    Learned,
    learned_in,
    learned_in_run,
    other_robots,
    warn_of_joints,
)
from roboverse_learn.commands.run_folder import RunFolder
from roboverse_learn.commands.tested_checkpoint import TestedCheckpoint, checkpoint_to_test
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, DatasetWriter, dataset_hash
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from roboverse_learn.data.sources.base import DemonstrationSource
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode

SAID = "The policy learned joints of 'franka' and moves those of 'iiwa'"
ACT = {
    "type": "act",
    "input_features": {"observation.images.front": {"type": "VISUAL", "shape": [3, 32, 32]}},
    "output_features": {"action": {"type": "ACTION", "shape": [2]}},
}
JOINTS = [f"motor{i}.pos" for i in range(9)]


@pytest.fixture(autouse=True)
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(robots: Sequence[str], *, collected: bool = False) -> Path:
    """Writes a dataset with an episode of each robot; of one collection, its settings name the first."""
    root = Path("demos")
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        for index, robot in enumerate(robots):
            episode = make_episode(index, length=2)
            named = {} if collected else {"robot": robot}
            writer.add_episode(replace(episode, metadata={**episode.metadata, **named}))
    if collected:
        words = ["task=PickCube", "image_size=32", *([f"robot={robots[0]}"] if robots[0] else [])]
        settings = DemonstrationSource(compose("collect", words)).settings()
        write_json(root / COLLECTION_PATH, {"settings": settings, "failed": []})
    return root


def write_checkpoint(folder: Path, **further: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / CONFIG).write_text(json.dumps(ACT))
    (folder / WEIGHTS).write_bytes(b"weights")
    for name, content in further.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    return folder


def write_run(*words: str, **facts: Any) -> Path:
    """Writes a run that was trained on the dataset."""
    config = compose("train", ["policy=act", "preset=quick", "device=cpu", "image_size=32", *words])
    with RunFolder.open(config, ["roboverse", "train"]) as run:
        with run.stage("collect") as recorded:
            recorded.update(facts)
        write_checkpoint(run.folder / "checkpoints/000100/pretrained_model")
        return run.folder


def to_test(checkpoint: Path, *words: str) -> TestedCheckpoint:
    words = (f"checkpoint={checkpoint}", "preset=quick", "device=cpu", *words)
    return checkpoint_to_test(compose("evaluate", list(words)))


@pytest.mark.parametrize("collected", [True, False], ids=["collection", "merged"])
def test_a_run_on_a_dataset_of_another_robot_warns_and_records_it(
    caplog: pytest.LogCaptureFixture, collected: bool
) -> None:
    root = write([""], collected=collected)
    run = write_run(f"dataset={root}", dataset_hash=dataset_hash(root))
    assert to_test(run, "robot=iiwa").config["learned_robots"] == ["franka"]
    assert SAID in caplog.text
    caplog.clear()
    for words in (["robot=franka"], []):
        assert "learned_robots" not in to_test(run, *words).config
    assert not caplog.records


def test_a_run_that_recorded_its_robots_reads_no_dataset(monkeypatch: pytest.MonkeyPatch) -> None:
    root = write([""])
    facts = {"dataset_hash": dataset_hash(root), "actions": ["j1", "j2"]}
    monkeypatch.setattr(learned_robots, "dataset_hash", None)
    trained = compose("train", ["policy=act", f"dataset={root}"])
    for robots in ([], ["", "iiwa"]):
        run = write_run(f"dataset={root}", f"train.steps={100 + len(robots)}", robots=robots, **facts)
        assert learned_in_run(run, trained) == Learned(tuple(robots), ("j1", "j2"))


def test_a_mixture_that_holds_the_robot_gets_no_warning(caplog: pytest.LogCaptureFixture) -> None:
    root = write(["", "iiwa"])
    run = write_run(f"dataset={root}", dataset_hash=dataset_hash(root))
    assert "learned_robots" not in to_test(run, "robot=iiwa").config
    assert not caplog.records


def test_actions_of_the_hand_transfer_without_a_warning_and_are_recorded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    root = write([""])
    run = write_run(f"dataset={root}", "task_kwargs.action_space=hand", dataset_hash=dataset_hash(root))
    assert to_test(run, "robot=iiwa").config["learned_robots"] == ["franka"]
    assert not caplog.records


def test_a_run_records_the_robots_of_a_dataset_that_is_gone(caplog: pytest.LogCaptureFixture) -> None:
    run = write_run("dataset=gone", robots=["", "ur5e"])
    assert to_test(run, "robot=iiwa").config["learned_robots"] == ["franka", "ur5e"]
    assert "learned joints of 'franka' and 'ur5e' and moves those of 'iiwa'" in caplog.text


def test_nothing_is_said_of_a_dataset_that_is_another_one_by_now(caplog: pytest.LogCaptureFixture) -> None:
    run = write_run(f"dataset={write([''])}", dataset_hash="0" * 64)
    assert "learned_robots" not in to_test(run, "robot=iiwa").config
    assert not caplog.records


@pytest.mark.parametrize(
    ("content", "shift", "warns"),
    [
        ({"dataset": {"root": "demos"}}, 0.0, True),
        ({"dataset": {"root": "demos"}}, 0.1, False),  # another dataset lies there by now
        ({"dataset": {"root": None}}, 0.0, False),
        ({"dataset": {"root": "elsewhere"}}, 0.0, False),
        ({"dataset": None}, 0.0, False),
    ],
)
def test_a_checkpoint_of_lerobot_train_warns_where_its_dataset_is_there(
    caplog: pytest.LogCaptureFixture, content: dict[str, Any], shift: float, warns: bool
) -> None:
    info = DatasetInfo.open(write([""], collected=True))
    checkpoint = write_checkpoint(Path("lerobot/pretrained_model"), train_config=content)
    mean = (info.stats["action"]["mean"] + shift).astype(np.float32)
    save_file(
        {"action.mean": mean}, checkpoint / "policy_preprocessor_step_3_normalizer_processor.safetensors"
    )
    found = to_test(checkpoint, "task=PickCube", "robot=iiwa")
    assert found.config.get("learned_robots") == (["franka"] if warns else None)
    assert (SAID in caplog.text) == warns == bool(caplog.records)


def test_a_checkpoint_of_a_program_that_names_no_dataset_gets_no_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    checkpoint = write_checkpoint(Path("own/pretrained_model"))
    assert "learned_robots" not in to_test(checkpoint, "task=PickCube", "robot=iiwa").config
    assert not caplog.records


def test_a_damaged_record_of_a_collection_is_no_reason_to_refuse_an_evaluation(
    caplog: pytest.LogCaptureFixture,
) -> None:
    root = write([""], collected=True)
    run = write_run(f"dataset={root}", dataset_hash=dataset_hash(root))
    Path("demos", COLLECTION_PATH).write_text("{")
    to_test(run, "robot=iiwa")
    shutil.rmtree("demos")
    to_test(run, "robot=iiwa")
    assert not caplog.records


@pytest.mark.parametrize(
    ("kind", "names", "learned"),
    [
        ("iiwa", ["a"], Learned(("iiwa",), ("a",))),
        ("panda", JOINTS, Learned((), tuple(JOINTS))),
        (None, {"motors": JOINTS}, Learned()),
    ],
)
def test_a_dataset_of_another_program_is_known_by_a_kind_of_robot_that_is_registered_here(
    kind: str | None, names: Any, learned: Learned
) -> None:
    features = {"action": {"names": names}}
    assert (
        learned_in(SimpleNamespace(root=Path(), robot_type=kind, episode_metadata=[{}], features=features))
        == learned
    )


@pytest.mark.parametrize(("kind", "robots"), [("franka", ("", "franka")), ("panda", ()), (None, ())], ids=str)
def test_episodes_that_name_no_robot_are_of_the_kind_that_the_dataset_names(
    kind: str | None, robots: tuple[str, ...]
) -> None:
    episodes = [{"task": "PickCube"}, {}]
    merged = SimpleNamespace(root=Path(), robot_type=kind, episode_metadata=episodes, features={})
    assert learned_in(merged).robots == robots


def test_joints_of_other_names_are_said_and_of_no_robot(caplog: pytest.LogCaptureFixture) -> None:
    env = EnvSpec(task="PickCube", robot="iiwa")
    own = env.make_task().controller.names
    for names in (JOINTS[:6], [f"{name.replace('/', '_')}.pos" for name in own], []):
        warn_of_joints(Learned((), tuple(names)), env)
    assert not caplog.records
    warn_of_joints(Learned((), tuple(JOINTS)), env)
    assert "learned the joints motor0.pos, motor1.pos" in caplog.text
    assert "and moves joint_1, joint_2" in caplog.text and "of 'iiwa'" in caplog.text
    assert other_robots(Learned((), tuple(JOINTS)), env) == []
