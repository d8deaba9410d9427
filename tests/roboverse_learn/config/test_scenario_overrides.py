"""What is changed of a scene on its way from the command line into a dataset and out of it again."""

import json
from pathlib import Path

import pytest

from envs.core.errors import DatasetError
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.commands.dataset_layout import dataset_layout
from roboverse_learn.commands.scene_labels import scenario_name
from roboverse_learn.config.compose import compose
from roboverse_learn.config.help import command_help
from roboverse_learn.config.scenario_overrides import scenario_keys
from roboverse_learn.config.schema import CollectConfig
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.recording import read_recordings
from roboverse_learn.replay import replay_recordings

WORDS = ["num_demos=1", "image_size=32", "num_workers=1", "collect.num_envs=2"]
SLOW = "scenario.physics.decimation=50"


def config(folder: Path, *words: str) -> CollectConfig:
    return compose("collect", [*WORDS, f"datasets_dir={folder}", *words])


@pytest.mark.slow
def test_a_dataset_of_a_changed_scene_records_the_change(tmp_path: Path) -> None:
    changed = config(tmp_path, SLOW, "scenario.cameras.front.fovy_deg=40")
    summary = collect_dataset(changed)
    info = DatasetInfo.open(summary.root)
    assert Path(summary.root).name.endswith(f"-{scenario_name(changed.env.scenario)}")
    assert info.fps == dataset_layout(changed)[1] == 10
    assert info.episode_metadata[0]["scenario"] == {
        "physics": {"decimation": 50},
        "cameras": {"front": {"fovy_deg": 40}},
    }
    recordings = read_recordings(summary.root, 0)
    replayed = replay_recordings(recordings, compose("replay", [f"dataset={summary.root}", "by=controls"]))
    assert replayed["control_hz"] == 10.0
    assert replayed["replays"]["controls"]["success_rate"] == 1.0


@pytest.mark.slow
def test_dataset_of_another_scene_is_not_continued(tmp_path: Path) -> None:
    first = config(tmp_path)
    collect_dataset(first)
    assert "scenario" not in DatasetInfo.open(dataset_folder(first)).episode_metadata[0]
    same = f"dataset={dataset_folder(first)}"
    with pytest.raises(DatasetError, match=r"scenario=None.*now given: scenario=\{'room': None\}"):
        collect_dataset(config(tmp_path, same, "num_demos=2", "scenario.room=null"))
    with pytest.raises(DatasetError, match="the episodes to be added have 20 and 10 fps"):
        collect_dataset(config(tmp_path, same, SLOW))


def test_sizes_of_images_and_names_are_no_keys_of_the_scene() -> None:
    assert not [key for key in scenario_keys() if key.endswith((".width", ".height", ".name"))]


def test_every_key_that_can_be_typed_is_in_the_help() -> None:
    said = command_help("collect")
    assert all(f"  {key}= " in said for key in scenario_keys() if "<" not in key)
    assert "Lamps along world x and along world y" in said


def test_a_name_follows_from_the_content_alone() -> None:
    one, same = {"room": None, "table": {"height_m": 0.5}}, {"table": {"height_m": 0.5}, "room": None}
    assert scenario_name(one) == scenario_name(same) != scenario_name(json.loads('{"room": null}'))
