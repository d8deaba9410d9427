import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from envs.core.errors import DatasetError, WriteError
from roboverse_learn.data import DatasetInfo, DatasetWriter, EpisodeData, dataset_hash, read_raw, recover
from roboverse_learn.data.dataset.stats import QUANTILES, column_stats, image_stats
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, TWO_CAMERAS, make_episode


def psnr_db(first, second):
    error = np.mean((np.asarray(first, float) - np.asarray(second, float)) ** 2)
    return 10 * np.log10(255**2 / max(error, 1e-9))


def write(root, indices, **kwargs):
    with DatasetWriter(root, fps=FPS, features=FEATURES, **kwargs) as writer:
        for index in indices:
            writer.add_episode(make_episode(index))


def test_lerobot_reads_back_every_frame(written, open_with_lerobot):
    dataset = open_with_lerobot(written)
    frame = 0
    for index in range(6):
        episode = make_episode(index)
        for t in range(episode.length):
            item = dataset[frame]
            np.testing.assert_array_equal(item["observation.state"], episode.states[t])
            np.testing.assert_array_equal(item["action"], episode.actions[t])
            assert item["next.reward"] == episode.rewards[t]
            assert bool(item["next.success"]) == bool(episode.successes[t])
            assert item["task"] == ("lift the cube" if index % 2 else "push the cube")
            assert (item["episode_index"], item["frame_index"], item["index"]) == (index, t, frame)
            image = item["observation.images.front"].permute(1, 2, 0)
            assert psnr_db(image, episode.images["front"][t]) > 30
            frame += 1
    assert len(dataset) == frame
    assert dataset.num_episodes == 6


def test_statistics_of_numbers_are_exact(written):
    info = DatasetInfo.open(written)
    states = np.concatenate([make_episode(i).states for i in range(6)])
    expected = column_stats({"x": states})["x"]
    for name, value in expected.items():
        np.testing.assert_allclose(info.stats["observation.state"][name], value, rtol=1e-9, atol=1e-12)


def test_statistics_of_images_have_lerobots_form(written):
    stats = DatasetInfo.open(written).stats["observation.images.front"]
    sampled = np.concatenate([make_episode(i).images["front"][::4] for i in range(6)])
    assert {name: value.shape for name, value in stats.items() if name != "count"} == dict.fromkeys(
        ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"), (3, 1, 1)
    )
    assert stats["count"] == [len(sampled)]
    pixels = sampled.reshape(-1, 3) / 255
    np.testing.assert_allclose(stats["mean"].ravel(), pixels.mean(0), rtol=1e-9)
    np.testing.assert_allclose(stats["std"].ravel(), pixels.std(0), rtol=1e-9)
    np.testing.assert_allclose(stats["max"].ravel(), pixels.max(0))


def test_quantiles_of_one_episodes_images():
    images = make_episode(3, length=9).images["front"]
    stats, pixels = image_stats(images), images[::4].reshape(-1, 3) / 255
    for name, quantile in QUANTILES.items():
        expected = np.quantile(pixels, quantile, axis=0, method="inverted_cdf")
        np.testing.assert_allclose(stats[name].ravel(), expected)


def test_raw_states_come_back_exactly(written):
    arrays, metadata = read_raw(written, 3)
    episode = make_episode(3)
    assert set(arrays) == {"qpos", "ctrl"}
    np.testing.assert_array_equal(arrays["qpos"], episode.raw["qpos"])
    assert arrays["qpos"].dtype == np.float64
    assert metadata == episode.metadata
    with pytest.raises(DatasetError, match=r"no raw states of episode 6.*It has 6 episodes, 0 to 5"):
        read_raw(written, 6)


def test_several_cameras(tmp_path, open_with_lerobot):
    images = {"front": np.full((5, 32, 32, 3), 90, np.uint8), "wrist": np.full((5, 16, 48, 3), 200, np.uint8)}
    column = np.zeros((5, 1), np.float32)
    with DatasetWriter(tmp_path / "d", fps=FPS, features=TWO_CAMERAS) as writer:
        writer.add_episode(EpisodeData(states=column, actions=column, images=images, task="look"))
    item = open_with_lerobot(tmp_path / "d")[4]
    assert item["observation.images.wrist"].shape == (3, 16, 48)
    assert abs(float(item["observation.images.wrist"].float().mean()) - 200) < 3


def test_resuming_gives_the_same_dataset_as_one_run(tmp_path, monkeypatch):
    monkeypatch.setattr("roboverse_learn.data.dataset.tables.EPISODES_PER_FILE", 2)
    write(tmp_path / "once", range(5))
    write(tmp_path / "twice", range(3))
    write(tmp_path / "twice", range(3, 5))
    assert dataset_hash(tmp_path / "once") == dataset_hash(tmp_path / "twice")
    assert (tmp_path / "once/meta/stats.json").read_bytes() == (
        tmp_path / "twice/meta/stats.json"
    ).read_bytes()
    assert len(DatasetInfo.open(tmp_path / "twice").data_files()) == 3


def test_a_second_writer_is_refused(tmp_path):
    with (
        DatasetWriter(tmp_path / "d", fps=FPS, features=FEATURES),
        pytest.raises(WriteError, match="Another process is writing to"),
    ):
        DatasetWriter(tmp_path / "d", fps=FPS, features=FEATURES)


@pytest.mark.parametrize(
    ("fps", "features", "said"),
    [
        (FPS, TWO_CAMERAS, r"observation\.state of shape \(3,\) and \(1,\)"),
        (30, FEATURES, f"{FPS} and 30 fps"),
    ],
)
def test_another_layout_is_refused_and_what_differs_is_named(fps, features, said, tmp_path):
    write(tmp_path / "d", [0])
    with pytest.raises(DatasetError, match=rf"d' and the episodes to be added have {said}\. Choose another"):
        DatasetWriter(tmp_path / "d", fps=fps, features=features)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"states": np.zeros((4, 2), np.float32)},
            r"'observation.state' has the shape \(4, 2\).*needs \(4, 3\)",
        ),
        ({"states": np.full((4, 3), np.nan, np.float32)}, "not finite at frame 0"),
        ({"images": {}}, r"missing \['observation.images.front'\]"),
        ({"images": {"front": np.zeros((4, 32, 32, 3), np.float32)}}, "images are uint8"),
        ({"metadata": {"seed": np.int64(3)}}, "metadata is not JSON"),
        ({"rewards": None}, r"missing \['next.reward'\]"),
    ],
)
def test_episodes_that_do_not_fit_are_refused_and_leave_nothing(tmp_path, change, message):
    with DatasetWriter(tmp_path / "d", fps=FPS, features=FEATURES) as writer:
        episode = make_episode(0, length=4)
        for name, value in change.items():
            setattr(episode, name, value)
        with pytest.raises(DatasetError, match=message):
            writer.add_episode(episode)
        assert writer.add_episode(make_episode(1)) == 0
    assert DatasetInfo.open(tmp_path / "d").num_episodes == 1


# Every write of one episode: staging writes 3 files, committing 4 more.
@pytest.mark.slow
@pytest.mark.parametrize("failing_write", range(7))
def test_a_full_disk_leaves_the_dataset_whole(tmp_path, monkeypatch, open_with_lerobot, failing_write):
    root = tmp_path / "d"
    write(root, range(2))
    before = dataset_hash(root)
    real_fsync, calls = os.fsync, iter(range(100))

    def fsync(descriptor):
        if next(calls) == failing_write:
            raise OSError(errno.ENOSPC, "No space left on device")
        real_fsync(descriptor)

    writer = DatasetWriter(root, fps=FPS, features=FEATURES)
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(WriteError, match=r"the disk is full.*Free some space .* run the same command"):
        writer.add_episode(make_episode(2))
    monkeypatch.undo()
    # The row is the commit: a disk that fills up after it leaves the episode in.
    committed = writer.num_episodes
    assert committed == (3 if failing_write >= 5 else 2)
    if committed == 2:
        writer.add_episode(make_episode(2))
    writer.close()
    assert len(open_with_lerobot(root)) == DatasetInfo.open(root).num_frames
    write(tmp_path / "undisturbed", range(3))
    assert dataset_hash(root) == dataset_hash(tmp_path / "undisturbed") != before
    assert not [path for path in root.rglob("*") if path.name.endswith(".partial")]


def test_recover_undoes_an_uncommitted_episode(tmp_path):
    root = tmp_path / "d"
    write(root, range(3))
    whole, info = dataset_hash(root), json.loads((root / "meta/info.json").read_text())
    # As if killed after the row was committed and before the totals were.
    info["total_episodes"], info["total_frames"] = 2, make_episode(0).length + make_episode(1).length
    (root / "meta/info.json").write_text(json.dumps(info))
    # As if killed before the row of a fourth episode.
    video = root / "videos/observation.images.front/chunk-000"
    (video / "file-003.mp4").write_bytes((video / "file-000.mp4").read_bytes())
    (root / "raw/episode_000003.safetensors").write_bytes(b"x")
    (root / "data/chunk-000/file-001.parquet").write_bytes(b"x")
    (video / ".file-004.mp4.1.partial").write_bytes(b"x")
    assert recover(root) == 3
    assert dataset_hash(root) == whole
    assert len(list(video.iterdir())) == 3
    assert len(list((root / "raw").iterdir())) == 3


def test_recover_names_a_folder_without_a_dataset(tmp_path):
    with pytest.raises(DatasetError, match=r"no dataset in '.*' \(meta/info.json is missing\)"):
        recover(tmp_path)


def test_no_frame_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr("roboverse_learn.data.dataset.video._packet_times", lambda buffer: np.arange(3))
    with (
        DatasetWriter(tmp_path / "d", fps=FPS, features=FEATURES) as writer,
        pytest.raises(DatasetError, match="kept 3 of 8 frames"),
    ):
        writer.add_episode(make_episode(0, length=8))


def test_file_names_are_lerobots(written):
    names = {path.relative_to(written).as_posix() for path in written.rglob("*") if path.is_file()}
    assert {
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "data/chunk-000/file-000.parquet",
        "videos/observation.images.front/chunk-000/file-005.mp4",
        "raw/episode_000005.safetensors",
    } <= names
    assert Path(written / ".staging").exists() is False
