"""Replays of recorded episodes in their own simulator and in another one, and their page."""

import contextlib
import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import envs
from envs.core.errors import DatasetError, ResultError
from envs.playback import HOLD_STEPS
from roboverse_learn.cli import main
from roboverse_learn.config.schema import ReplayConfig
from roboverse_learn.data.dataset.recording import read_recordings
from roboverse_learn.replay import replay_recordings
from roboverse_learn.sim2sim.parity import parity_page as page
from roboverse_learn.sim2sim.parity import summary, tracks


@pytest.fixture(scope="module")
def env(recordings):
    with contextlib.closing(
        envs.make_vec("PickCube", len(recordings), split="train", observation="state", num_threads=1)
    ) as env:
        yield env


@pytest.fixture(scope="module")
def same(dataset, recordings):
    """Episodes of MuJoCo replayed in MuJoCo, one at a time."""
    return replay_recordings(recordings, ReplayConfig(dataset=str(dataset), num_envs=1))


@pytest.fixture(scope="module")
def warp(dataset, recordings):
    config = ReplayConfig(dataset=str(dataset), simulator="mujoco_warp", num_envs=2)
    return replay_recordings(recordings, config)


@pytest.mark.slow
def test_recording_has_states_actions_and_metadata(recordings):
    for index, recording in enumerate(recordings):
        assert recording.index == index
        assert recording.states.num_envs == recording.num_steps + 1
        assert recording.actions.shape == (recording.num_steps, 9)
        assert recording.metadata["simulator"] == "mujoco"


@pytest.mark.slow
def test_replay_in_the_same_simulator_is_bit_identical(same):
    assert (same["recorded_in"], same["replayed_in"], same["num_episodes"]) == ("mujoco", "mujoco", 2)
    for found in same["replays"].values():
        assert found["success_rate"] == found["recorded_success_rate"] == 1.0
        assert found["checks"]["agree"] == found["checks"]["asked"]
        assert found["far_after_s"] == [None, None]
        for values in found["drift"].values():
            assert values["largest"] == 0.0


@pytest.mark.slow
def test_replay_by_states_agrees_in_another_simulator(warp):
    found = warp["replays"]["states"]
    assert found["success_rate"] == 1.0
    assert found["checks"]["agree"] == found["checks"]["asked"] > 0
    assert found["drift"]["end_effector_m"]["largest"] < 2e-6
    assert found["drift"]["objects_m"]["largest"] < 1e-6


@pytest.mark.slow
def test_replay_by_controls_drifts_in_another_simulator(warp):
    found = warp["replays"]["controls"]
    assert found["success_rate"] == 1.0
    assert 0.0 < found["drift"]["end_effector_m"]["largest"] < 5e-3
    curve = found["drift"]["objects_m"]["over_time"]
    assert len(curve["median"]) == len(curve["p90"]) > 20
    assert (np.array(curve["p90"]) >= np.array(curve["median"])).all()


def test_summary_of_a_failed_replay_shows_failure_and_drift(env, recordings):
    still = [
        dataclasses.replace(r, actions=np.repeat(r.actions[:1], r.num_steps, axis=0)) for r in recordings
    ]
    recorded = [tracks.recorded_success(env, recording) for recording in recordings]
    found = summary.summarize(env.scenario, still, tracks.by_controls(env, still), recorded)
    assert (found["success_rate"], found["recorded_success_rate"]) == (0.0, 1.0)
    assert found["checks"]["agree"] < found["checks"]["asked"]
    assert found["drift"]["objects_m"]["last"]["median"] > 0.05
    assert all(0.0 < after < recordings[0].num_steps / 20.0 for after in found["far_after_s"])
    assert [episode["replayed"] for episode in found["episodes"]] == [False, False]


def test_last_action_is_held(env, recordings):
    (track,) = tracks.by_controls(env, recordings[:1])
    assert len(track.success) == recordings[0].num_steps + 1 + HOLD_STEPS
    assert track.states.num_envs == recordings[0].num_steps + 1


@pytest.mark.slow
def test_page_is_a_function_of_the_summaries(tmp_path, same, warp):
    paths = [summary.write(tmp_path, {**values, "note": "A note."}) for values in (same, warp)]
    assert [path.name for path in paths] == [
        "PickCube-mujoco-to-mujoco.json",
        "PickCube-mujoco-to-mujoco_warp.json",
    ]
    written = page.write_page(tmp_path)
    text = written["table"].read_text()
    assert "| PickCube | mujoco | mujoco | 2 | 100 % |" in text
    assert "| 100 % | 0 (0) | 0 (0) | 0 of 2 |" in text
    assert "**PickCube, mujoco → mujoco_warp**: A note." in text
    assert "![PickCube-mujoco-to-mujoco_warp](PickCube-mujoco-to-mujoco_warp.png)" in text
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert before.keys() == {
        "parity.md",
        *(f"PickCube-mujoco-to-{to}.{kind}" for to in ("mujoco", "mujoco_warp") for kind in ("json", "png")),
    }
    page.write_page(tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_file_name_contains_task_options(same):
    assert summary.file_name({**same, "task": "metaworld/reach", "task_kwargs": {"variant": "lift"}}) == (
        "metaworld_reach-variant=lift-mujoco-to-mujoco"
    )


def test_other_json_files_are_refused(tmp_path):
    (tmp_path / "notes.json").write_text("{}")
    with pytest.raises(ResultError, match=r"notes.json' is no summary of a replay. Keep other files out"):
        page.write_page(tmp_path)
    (tmp_path / "notes.json").write_text("{")
    with pytest.raises(ResultError, match=r"notes.json' is not a JSON file.*run again"):
        page.write_page(tmp_path)
    assert not (tmp_path / "parity.md").exists()


def test_command_writes_summary_and_page_into_the_folder_that_is_named(
    tmp_path, dataset, capsys, monkeypatch
):
    (working := tmp_path / "working").mkdir()
    monkeypatch.chdir(working)
    words = [f"dataset={dataset}", "episodes=1", "by=[states]", "out=../out"]
    assert main(["replay", *words]) == 0
    assert not list(working.iterdir())
    tmp_path /= "out"
    shown = capsys.readouterr().out
    assert "PickCube, mujoco to mujoco, 1 episodes" in shown
    assert "by states: 100.0 % success" in shown
    values = json.loads((tmp_path / "PickCube-mujoco-to-mujoco.json").read_text())
    assert values["num_episodes"] == 1
    assert list(values["replays"]) == ["states"]
    assert "not replayed" in (tmp_path / "parity.md").read_text()


def test_a_replay_does_not_take_the_place_of_that_of_another_dataset(tmp_path, dataset, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(dataset, "moved")
    shutil.copytree(dataset, "other")
    (data,) = Path("other/data").rglob("*.parquet")
    table = pq.read_table(data)
    index, actions = table.schema.get_field_index("action"), np.array(table["action"].to_pylist(), np.float32)
    moved = pa.array((actions + 0.001).tolist(), table.schema.field("action").type)
    pq.write_table(table.set_column(index, table.schema.field("action"), moved), data)
    words = ["replay", "episodes=1", "by=[states]"]
    assert main([*words, f"dataset={dataset}"]) == 0
    before = {path: path.read_bytes() for path in Path("replays").iterdir()}
    assert main([*words, "dataset=other"]) == 2
    said = capsys.readouterr().err
    assert (
        f"PickCube-mujoco-to-mujoco.json' is of the replay of dataset={dataset}, and that of dataset=ot"
        in said
    )
    assert "Add out=replays/other to write beside it" in said
    assert {path: path.read_bytes() for path in Path("replays").iterdir()} == before
    assert main([*words, "dataset=other", "out=replays/other"]) == 0
    for same in (dataset, "moved"):
        assert main([*words, f"dataset={same}"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "replay needs dataset=<folder>"),
        (["dataset=nowhere"], "There is no dataset in 'nowhere'"),
        (["dataset=x", "simulatr=mujoco"], "Unknown key 'simulatr' of replay. Did you mean 'simulator'?"),
        (["dataset=x", "simulator=mujco"], "Unknown simulator 'mujco'. Did you mean 'mujoco'?"),
        (["dataset=x", "by=[stats]"], "by.0: input should be 'states' or 'controls', given 'stats'"),
        (["dataset=x", "by=[]"], "replay needs a way"),
        (["dataset=x", "num_envs=0"], "num_envs must be above 0, given 0"),
    ],
)
def test_invalid_settings_name_the_mistake(words, message, capsys):
    assert main(["replay", *words]) == 2
    assert message in capsys.readouterr().err


def test_dataset_without_states_or_metadata_is_refused(tmp_path, dataset, monkeypatch):
    root = tmp_path / "d"
    shutil.copytree(dataset, root)
    for path in (root / "raw").rglob("*.safetensors"):
        path.unlink()
    with pytest.raises(DatasetError, match=r"has no raw states of episode 0.*hold no raw states"):
        read_recordings(root)
    from roboverse_learn.data.dataset import recording

    monkeypatch.setattr(recording, "read_raw", lambda *_: ({}, {"task": "PickCube", "episode": 3}))
    with pytest.raises(DatasetError, match="does not say its split, simulator, so it cannot be replayed"):
        read_recordings(root)


def test_actions_of_another_size_are_refused(dataset, recordings):
    short = [dataclasses.replace(recordings[0], actions=recordings[0].actions[:, :4])]
    with pytest.raises(DatasetError, match=r"have 4 numbers; those of PickCube have 9: joint1"):
        replay_recordings(short, ReplayConfig(dataset=str(dataset)))
