"""Damaged and foreign folders; a dataset's metadata; copies for publishing."""

import json
import shutil
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.errors import DatasetError, WriteError
from roboverse_learn.data import DatasetInfo, ResidentDataset, consolidate, dataset_hash, read_raw
from roboverse_learn.dataset import dataset
from tests.roboverse_learn.data.synthetic_episodes import make_episode

CAMERA = "observation.images.front"
ROWS = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-000.parquet"


@pytest.fixture
def damaged(written, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(written, tmp_path / "d")


def edit(path, **changes):
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def refused(root, message):
    with pytest.raises(DatasetError, match=message):
        ResidentDataset(root)


def test_a_path_without_a_dataset_says_what_is_there_and_what_may_be_meant(damaged):
    file = damaged / "meta/info.json"
    with pytest.raises(DatasetError, match=r"info.json' is a file, and a dataset is a folder"):
        DatasetInfo.open(file)
    near, far = damaged.with_name("dd"), damaged.parent / "dd/e"
    with pytest.raises(DatasetError, match=f"There is no dataset.*Did you mean '{damaged}'.*Collect one"):
        DatasetInfo.open(near)
    with pytest.raises(DatasetError, match=r"is missing\). Collect one there first"):
        DatasetInfo.open(far)


def test_what_a_dataset_says_of_itself(written):
    info, episodes = DatasetInfo.open(written), [make_episode(index) for index in range(6)]
    assert (info.num_episodes, info.fps, info.robot_type) == (6, 20, "franka")
    assert info.episode_lengths.tolist() == [episode.length for episode in episodes]
    assert info.episode_starts[0] == 0 and info.episode_ends[-1] == info.num_frames
    assert info.tasks == ("push the cube", "lift the cube")
    assert info.camera_keys == (CAMERA,) and info.shapes[CAMERA] == (32, 32, 3)
    assert info.episode_metadata[4] == episodes[4].metadata
    columns = info.read_columns(["action", "frame_index"])
    np.testing.assert_array_equal(columns["action"], np.concatenate([e.actions for e in episodes]))
    assert columns["frame_index"].tolist() == [t for e in episodes for t in range(e.length)]


class TestDamage:
    def test_info_that_is_no_description(self, damaged):
        (damaged / "meta/info.json").write_text('["fps", 20]')
        refused(damaged, r"info.json' is truncated or damaged \(it does not describe a dataset\). Restore it")

    @pytest.mark.parametrize("key", ["fps", "features", "total_frames"])
    def test_info_that_lacks_a_key(self, damaged, key):
        path = damaged / "meta/info.json"
        path.write_text(json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != key}))
        refused(damaged, "it does not describe a dataset")

    def test_info_of_another_version(self, damaged):
        edit(damaged / "meta/info.json", codebase_version="v2.1")
        refused(damaged, r"has the version v2.1; valid is v3.0. Convert it with LeRobot's convert_dataset")

    @pytest.mark.parametrize("version", ["v4.0", None])
    def test_info_of_a_version_that_lerobot_cannot_convert(self, damaged, version):
        edit(damaged / "meta/info.json", codebase_version=version)
        refused(damaged, rf"has the version {version}; valid is v3.0. Name a dataset of v3.0, or write")

    @pytest.mark.parametrize(
        ("key", "value", "said"),
        [
            ("fps", "20", "fps must be a number above 0, given '20'"),
            ("fps", 0, "fps must be a number above 0, given 0"),
            ("total_frames", "x", "total_frames must be a whole number, 0 or more, given 'x'"),
            ("total_episodes", -1, "total_episodes must be a whole number, 0 or more, given -1"),
            ("total_frames", 1, r"total_frames is 1, and the episodes have \d+ frames"),
            ("features", [], "features must name at least one feature"),
            ("features", {}, "features must name at least one feature"),
            ("features", {"action": 3}, "the feature action has no dtype or no shape"),
        ],
    )
    def test_info_with_a_value_that_no_dataset_has(self, damaged, key, value, said):
        edit(damaged / "meta/info.json", **{key: value})
        refused(damaged, rf"info.json' is truncated or damaged \({said}\)")

    @pytest.mark.parametrize("name", ["info", "stats"])
    def test_a_folder_in_place_of_a_file(self, damaged, name):
        (damaged / f"meta/{name}.json").unlink()
        (damaged / f"meta/{name}.json").mkdir()
        refused(damaged, rf"meta/{name}.json' is truncated or damaged \(.*Is a directory")

    @pytest.mark.parametrize("value", [[], {"action": 3}])
    def test_statistics_of_another_form(self, damaged, value):
        (damaged / "meta/stats.json").write_text(json.dumps(value))
        refused(damaged, r"stats.json' is truncated or damaged \(it does not hold statistics by feature\)")

    def test_no_episode_yet(self, damaged):
        edit(damaged / "meta/info.json", total_episodes=0)
        refused(damaged, r"has no episode yet. Collect some first")

    def test_rows_that_are_missing(self, damaged):
        edit(damaged / "meta/info.json", total_episodes=9)
        refused(damaged, r"meta/episodes' is truncated or damaged \(6 of 9 episodes are listed\)")

    def test_frames_that_are_missing(self, damaged):
        edit(damaged / "meta/info.json", total_frames=1000)
        refused(damaged, r"data' is truncated or damaged \('\S+' has \d+ of 1000 frames\)")

    @pytest.mark.parametrize("column", ["length", "dataset_from_index"])
    def test_rows_that_lack_a_column(self, damaged, column):
        pq.write_table(pq.read_table(damaged / ROWS).drop_columns(column), damaged / ROWS)
        refused(damaged, rf"{ROWS}' is truncated or damaged \(it lacks the columns \['{column}'\]\)")

    def test_numbers_that_lack_a_column(self, damaged):
        pq.write_table(pq.read_table(damaged / DATA).drop_columns("action"), damaged / DATA)
        refused(damaged, rf"{DATA}' is truncated or damaged \(it lacks the columns \['action'\]\)")

    def test_bytes_that_are_no_table(self, damaged):
        (damaged / "meta/tasks.parquet").write_bytes(b"PAR1 and nothing more")
        refused(damaged, r"tasks.parquet' is truncated or damaged .*Restore it from a copy, or delete")

    def test_a_video_that_is_text(self, damaged):
        (damaged / f"videos/{CAMERA}/chunk-000/file-001.mp4").write_text("not a video")
        refused(damaged, r"file-001.mp4' is truncated or damaged")

    def test_a_video_that_is_missing_has_no_hash(self, damaged):
        (damaged / f"videos/{CAMERA}/chunk-000/file-001.mp4").unlink()
        with pytest.raises(DatasetError, match=r"The video '.*file-001.mp4' is missing. Restore it"):
            dataset_hash(damaged)

    def test_a_folder_in_place_of_a_video_has_no_hash(self, damaged):
        path = damaged / f"videos/{CAMERA}/chunk-000/file-001.mp4"
        path.unlink()
        path.mkdir()
        with pytest.raises(DatasetError, match=r"file-001.mp4' is truncated or damaged \(it is a folder\)"):
            dataset_hash(damaged)

    @pytest.mark.parametrize("kept", [0, 7, 60])
    def test_raw_states_that_are_cut_off(self, damaged, kept):
        path = damaged / "raw/episode_000002.safetensors"
        path.write_bytes(path.read_bytes()[:kept])
        with pytest.raises(DatasetError, match=r"episode_000002.safetensors' is truncated or damaged"):
            read_raw(damaged, 2)

    def test_statistics_may_be_absent(self, damaged):
        (damaged / "meta/stats.json").unlink()
        assert DatasetInfo.open(damaged).stats == {}

    def test_tasks_in_any_order_are_put_in_theirs(self, damaged):
        table = pq.read_table(damaged / "meta/tasks.parquet")
        pq.write_table(table.take(pa.array([1, 0])), damaged / "meta/tasks.parquet")
        assert DatasetInfo.open(damaged).tasks == ("push the cube", "lift the cube")


class TestHash:
    def test_a_copy_has_the_hash_of_its_original(self, written, damaged):
        assert dataset_hash(damaged) == dataset_hash(written)

    @pytest.mark.parametrize(
        "name", ["raw/episode_000003.safetensors", f"videos/{CAMERA}/chunk-000/file-003.mp4"]
    )
    def test_another_episodes_file_changes_it(self, written, damaged, name):
        shutil.copy(damaged / name.replace("3.", "0."), damaged / name)
        assert dataset_hash(damaged) != dataset_hash(written)

    def test_raw_states_that_one_episode_alone_lacks_are_named_and_none_at_all_are_no_damage(self, damaged):
        (damaged / "raw/episode_000002.safetensors").unlink()
        said = (
            r"episode_000002.safetensors' is missing, and other .* or delete the dataset's folder and collect"
        )
        for call in (lambda: dataset_hash(damaged), lambda: dataset(["info", f"dataset={damaged}"])):
            with pytest.raises(DatasetError, match=said):
                call()
        shutil.rmtree(damaged / "raw")
        assert len(dataset_hash(damaged)) == 64


class TestConsolidated:
    def test_the_copy_appears_whole_or_not_at_all(self, written, tmp_path, monkeypatch):
        def full(*_args, **_kwargs):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(sys.modules[consolidate.__module__], "link_file", full)
        with pytest.raises(WriteError, match=r"big' could not be written: the disk is full"):
            consolidate(written, tmp_path / "big")
        assert not list(tmp_path.iterdir())

    def test_the_copy_is_complete_and_the_original_untouched(self, written, tmp_path):
        before = {p: p.read_bytes() for p in written.rglob("*") if p.is_file() and ".cache" not in p.parts}
        info = consolidate(written, tmp_path / "big")
        original = DatasetInfo.open(written)
        assert len(list((tmp_path / "big/videos").rglob("*.mp4"))) == 1
        assert info.episode_lengths.tolist() == original.episode_lengths.tolist()
        assert info.tasks == original.tasks and info.fps == original.fps
        for key in ("observation.state", "action"):
            np.testing.assert_array_equal(info.read_columns([key])[key], original.read_columns([key])[key])
            np.testing.assert_allclose(info.stats[key]["mean"], original.stats[key]["mean"], rtol=1e-6)
        for index in range(6):
            arrays, metadata = read_raw(tmp_path / "big", index)
            np.testing.assert_array_equal(arrays["qpos"], make_episode(index).raw["qpos"])
            assert metadata["episode"] == index
        assert {path: path.read_bytes() for path in before} == before


@pytest.fixture(scope="module")
def both(written, tmp_path_factory):
    """The same frames in main memory and mapped."""
    root = shutil.copytree(written, tmp_path_factory.mktemp("mapped") / "d")
    return ResidentDataset(root), ResidentDataset(root, memory_fraction=1e-12)


class TestMapped:
    @given(data=st.data())
    @settings(max_examples=30, deadline=None)
    def test_batches_are_those_of_main_memory(self, both, data):
        indices = data.draw(st.lists(st.integers(0, len(both[0]) - 1), min_size=1, max_size=8))
        window = data.draw(st.lists(st.integers(-4, 4), min_size=1, max_size=4))
        deltas = {CAMERA: window, "action": window}
        first, second = (resident.sample(indices, deltas) for resident in both)
        assert first.keys() == second.keys()
        assert all(torch.equal(first[key], second[key]) for key in first)

    def test_writing_to_a_batch_or_a_frame_never_reaches_the_file(self, both):
        memory, mapped = both
        (file,) = (memory.info.root / ".cache").iterdir()
        before = file.read_bytes()
        mapped.sample([0])[CAMERA].zero_()
        assert torch.equal(mapped.frames[CAMERA], memory.frames[CAMERA])
        mapped.frames[CAMERA][0] = 0  # the map is copy-on-write
        assert file.read_bytes() == before
        mapped.frames[CAMERA][0] = memory.frames[CAMERA][0]

    def test_another_video_makes_a_new_map(self, damaged):
        ResidentDataset(damaged, memory_fraction=1e-12)
        (before,) = (damaged / ".cache").iterdir()
        videos = damaged / f"videos/{CAMERA}/chunk-000"
        (videos / "file-000.mp4").touch()
        ResidentDataset(damaged, memory_fraction=1e-12)
        (after,) = (damaged / ".cache").iterdir()
        assert after.name != before.name

    def test_a_damaged_video_leaves_no_map(self, damaged):
        path = damaged / f"videos/{CAMERA}/chunk-000/file-004.mp4"
        path.write_bytes(path.read_bytes()[:200])
        with pytest.raises(DatasetError, match=r"file-004.mp4' is truncated or damaged"):
            ResidentDataset(damaged, memory_fraction=1e-12)
        assert not list((damaged / ".cache").iterdir())
