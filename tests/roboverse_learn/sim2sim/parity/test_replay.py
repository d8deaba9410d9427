"""Recorded episodes in the simulator that they come from, in another one, and the page that tells."""

import contextlib
import dataclasses
import json
import shutil

import numpy as np
import pytest

import envs
from envs.core.errors import DatasetError, ResultError
from envs.playback import HOLD_STEPS
from roboverse_learn.cli import main
from roboverse_learn.config.schema import ReplayConfig
from roboverse_learn.replay import replay_recordings
from roboverse_learn.sim2sim.parity import page, summary
from roboverse_learn.sim2sim.parity import tracks as replaying
from roboverse_learn.sim2sim.parity.recording import read_recordings


@pytest.fixture(scope="module")
def env(recordings):
    with contextlib.closing(
        envs.make_vec("PickCube", len(recordings), split="train", observation="state", num_threads=1)
    ) as env:
        yield env


@pytest.fixture(scope="module")
def same(dataset, recordings):
    """MuJoCo's episodes in MuJoCo, one after the other."""
    return replay_recordings(recordings, ReplayConfig(dataset=str(dataset), num_envs=1))


@pytest.fixture(scope="module")
def warp(dataset, recordings):
    config = ReplayConfig(dataset=str(dataset), simulator="mujoco_warp", num_envs=2)
    return replay_recordings(recordings, config)


def test_a_recording_is_the_episode(recordings):
    for index, recording in enumerate(recordings):
        assert recording.index == index
        assert recording.moments.num_envs == recording.num_steps + 1
        assert recording.actions.shape == (recording.num_steps, 9)
        assert recording.metadata["simulator"] == "mujoco"


def test_in_its_own_simulator_an_episode_is_the_same_to_the_bit(same):
    assert (same["recorded_in"], same["replayed_in"], same["num_episodes"]) == ("mujoco", "mujoco", 2)
    for found in same["replays"].values():
        assert found["success_rate"] == found["recorded_success_rate"] == 1.0
        assert found["checks"]["agree"] == found["checks"]["asked"]
        assert found["far_after_s"] == [None, None]
        for values in found["drift"].values():
            assert values["largest"] == 0.0


def test_states_are_the_same_in_another_simulator(warp):
    found = warp["replays"]["states"]
    assert found["success_rate"] == 1.0
    assert found["checks"]["agree"] == found["checks"]["asked"] > 0
    assert found["drift"]["end_effector_m"]["largest"] < 2e-6
    assert found["drift"]["objects_m"]["largest"] < 1e-6


def test_controls_in_another_simulator_drift(warp):
    found = warp["replays"]["controls"]
    assert found["success_rate"] == 1.0
    assert 0.0 < found["drift"]["end_effector_m"]["largest"] < 5e-3
    curve = found["drift"]["objects_m"]["over_time"]
    assert len(curve["median"]) == len(curve["p90"]) > 20
    assert (np.array(curve["p90"]) >= np.array(curve["median"])).all()


def test_what_goes_wrong_is_told(env, recordings):
    still = [
        dataclasses.replace(r, actions=np.repeat(r.actions[:1], r.num_steps, axis=0)) for r in recordings
    ]
    recorded = [replaying.recorded_success(env, recording) for recording in recordings]
    found = summary.summarize(env.scenario, still, replaying.by_controls(env, still), recorded)
    assert (found["success_rate"], found["recorded_success_rate"]) == (0.0, 1.0)
    assert found["checks"]["agree"] < found["checks"]["asked"]
    assert found["drift"]["objects_m"]["last"]["median"] > 0.05
    assert all(0.0 < after < recordings[0].num_steps / 20.0 for after in found["far_after_s"])
    assert [episode["replayed"] for episode in found["episodes"]] == [False, False]


def test_the_last_action_is_held(env, recordings):
    """An episode that is cut off before its success succeeds in the steps that follow, or does not count."""
    (track,) = replaying.by_controls(env, recordings[:1])
    assert len(track.success) == recordings[0].num_steps + 1 + HOLD_STEPS
    assert track.moments.num_envs == recordings[0].num_steps + 1


def test_the_page_is_a_function_of_the_files(tmp_path, same, warp):
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


def test_options_of_a_task_are_in_the_name(same):
    assert summary.file_name({**same, "task": "metaworld/reach", "task_kwargs": {"variant": "lift"}}) == (
        "metaworld_reach-variant=lift-mujoco-to-mujoco"
    )


def test_files_of_others_are_refused(tmp_path):
    (tmp_path / "notes.json").write_text("{}")
    with pytest.raises(ResultError, match=r"notes.json' is no summary of a replay. Keep other files out"):
        page.write_page(tmp_path)
    (tmp_path / "notes.json").write_text("{")
    with pytest.raises(ResultError, match=r"notes.json' is no JSON file.*replay again"):
        page.write_page(tmp_path)
    assert not (tmp_path / "parity.md").exists()


def test_the_command(tmp_path, dataset, capsys):
    words = [f"dataset={dataset}", "episodes=1", "by=[states]", f"out={tmp_path}"]
    assert main(["replay", *words]) == 0
    shown = capsys.readouterr().out
    assert "PickCube, mujoco to mujoco, 1 episodes" in shown
    assert "by states: 100.0 % success" in shown
    values = json.loads((tmp_path / "PickCube-mujoco-to-mujoco.json").read_text())
    assert values["num_episodes"] == 1
    assert list(values["replays"]) == ["states"]
    assert "not replayed" in (tmp_path / "parity.md").read_text()


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
def test_mistakes_are_told_in_a_sentence(words, message, capsys):
    assert main(["replay", *words]) == 2
    assert message in capsys.readouterr().err


def test_a_dataset_that_does_not_say_where_it_is_from_is_refused(tmp_path, dataset, monkeypatch):
    root = tmp_path / "d"
    shutil.copytree(dataset, root)
    for path in (root / "raw").rglob("*.safetensors"):
        path.unlink()
    with pytest.raises(DatasetError, match=r"has no raw states of episode 0.*hold no raw states"):
        read_recordings(root)
    from roboverse_learn.sim2sim.parity import recording

    monkeypatch.setattr(recording, "read_raw", lambda *_: ({}, {"task": "PickCube", "episode": 3}))
    with pytest.raises(DatasetError, match="does not say its split, simulator, so it cannot be replayed"):
        read_recordings(root)


def test_actions_of_another_kind_are_refused(dataset, recordings):
    short = [dataclasses.replace(recordings[0], actions=recordings[0].actions[:, :4])]
    with pytest.raises(DatasetError, match=r"have 4 numbers; those of PickCube have 9: joint1"):
        replay_recordings(short, ReplayConfig(dataset=str(dataset)))
