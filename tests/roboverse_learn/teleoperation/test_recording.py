import dataclasses
import re

import numpy as np
import pytest

from envs.core.errors import DatasetError, LockedError
from envs.spec import EnvSpec
from roboverse_learn.teleoperation.episode_book import EpisodeBook
from roboverse_learn.teleoperation.recording import (
    SUFFIX,
    Mark,
    Recording,
    RecordingFolder,
    open_recordings,
    recordings_in,
    scene_of,
)

SCENE = scene_of(EnvSpec())


def recording(episode=0, mark=Mark.SUCCESS, steps=4):
    rng = np.random.default_rng(episode)
    return Recording(
        states={"robots/franka/joint_pos": rng.normal(size=(steps + 1, 9))},
        actions=rng.normal(size=(steps, 9)).astype(np.float32),
        hand_actions=np.zeros((steps, 7), np.float32),
        successes=np.arange(steps) >= 2,
        interventions=np.ones(steps, bool),
        facts={"scene": SCENE, "episode": episode, "mark": str(mark)},
    )


def test_a_recording_is_read_as_it_was_written(tmp_path):
    written = recording()
    written.write(tmp_path / f"0{SUFFIX}")
    read = Recording.read(tmp_path / f"0{SUFFIX}")
    assert read.mark is Mark.SUCCESS and read.length == 4 and read.facts == written.facts
    for name in ("actions", "hand_actions", "successes", "interventions"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_array_equal(*(each.states["robots/franka/joint_pos"] for each in (read, written)))


def test_a_folder_is_continued_and_marks_are_changed(tmp_path):
    folder = RecordingFolder(tmp_path, SCENE)
    folder.add(recording(5))
    path = folder.add(recording(6))
    folder.remark(path, Mark.DISCARDED)
    folder.close()
    again = RecordingFolder(tmp_path, SCENE)
    assert [path.name for path in recordings_in(tmp_path)] == [f"00000{i}{SUFFIX}" for i in (0, 1)]
    assert again.solved_episodes() == {5}
    assert again.count(Mark.DISCARDED) == 1
    assert again.add(recording(7)).name.startswith("000002")
    again.close()


def test_a_kill_while_writing_leaves_the_others(tmp_path):
    folder = RecordingFolder(tmp_path, SCENE)
    folder.add(recording(5))
    (tmp_path / f".000001{SUFFIX}.0123abcd.partial").write_bytes(b"half")
    folder.close()
    again = RecordingFolder(tmp_path, SCENE)
    assert len(again.facts) == 1 and not list(tmp_path.glob(".0*partial"))
    again.close()


def test_a_folder_of_another_scene_or_in_use_or_damaged_is_refused(tmp_path):
    folder = RecordingFolder(tmp_path, SCENE)
    folder.add(recording())
    with pytest.raises(LockedError, match="Another process is writing"):
        RecordingFolder(tmp_path, SCENE)
    folder.close()
    with pytest.raises(DatasetError, match="was begun with task='PickCube'; now given: task='StackCube'"):
        RecordingFolder(tmp_path, scene_of(EnvSpec(task="StackCube")))
    (tmp_path / f"000009{SUFFIX}").write_bytes(b"no tensors")
    with pytest.raises(DatasetError, match=f"000009{SUFFIX}"):
        RecordingFolder(tmp_path, SCENE)


def test_looks_are_no_part_of_the_scene():
    assert scene_of(EnvSpec(level=3, image_size=64, cameras=("wrist",))) == SCENE
    assert scene_of(EnvSpec(task_kwargs={"variant": "lift"})) != SCENE


def test_recordings_of_another_robot_are_refused(tmp_path):
    folder = RecordingFolder(tmp_path, SCENE)
    folder.add(recording())
    folder.close()
    with pytest.raises(DatasetError, match="was begun with robot=None; now given: robot='iiwa'"):
        RecordingFolder(tmp_path, scene_of(EnvSpec(robot="iiwa")))


def test_no_recordings_say_how_to_make_some(tmp_path):
    with pytest.raises(DatasetError, match="roboverse teleoperate task="):
        open_recordings(tmp_path)


def test_a_path_that_is_no_folder_of_recordings_names_the_one_that_is_meant(tmp_path):
    folder = RecordingFolder(tmp_path / "PickCube/recordings", SCENE)
    file = folder.add(recording())
    folder.close()
    (tmp_path / "file").touch()
    meant = f"Did you mean path={folder.root}? Make some with: roboverse teleoperate"
    for path, said in (
        (file, f"needed is the folder that holds the recordings (*{SUFFIX}). {meant}"),
        (tmp_path / "PickCube", f"there is no recording of teleoperation (*{SUFFIX}). {meant}"),
        (tmp_path / "file", f"needed is the folder that holds the recordings (*{SUFFIX}). Make some"),
        (tmp_path / "none", "there is no such folder. Make some with"),
    ):
        with pytest.raises(DatasetError, match=re.escape(said)):
            open_recordings(path)


def test_lengths_that_do_not_fit_are_damage(tmp_path):
    broken = dataclasses.replace(recording(), actions=np.zeros((3, 9), np.float32))
    broken.write(tmp_path / f"0{SUFFIX}")
    with pytest.raises(DatasetError, match="no recording of teleoperation"):
        Recording.read(tmp_path / f"0{SUFFIX}")


def test_episodes_are_handed_out_once_and_not_after_a_success(tmp_path):
    folder = RecordingFolder(tmp_path, SCENE)
    folder.add(recording(3))
    book = EpisodeBook(folder, [3, 4, 5, 6], wanted=3)
    assert [book.take(), book.take()] == [4, 5]
    book.give_back(4)
    assert book.take() == 4
    book.give_back(5, skip=True)
    assert book.take() == 6 and book.take() is None
    path = book.add(recording(6))
    book.add(recording(4))
    assert book.is_full and book.kept == 3
    book.discard(path)
    assert not book.is_full and [row["mark"] for row in book.rows()] == ["success", "discarded", "success"]
    folder.close()
