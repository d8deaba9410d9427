import shutil

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from envs.core.errors import DatasetError
from roboverse_learn.data import DatasetInfo, EpisodeAwareSampler, ResidentDataset, consolidate
from roboverse_learn.data.dataset.frame_table import clamp_window
from tests.roboverse_learn.data.synthetic_episodes import FPS, SIZE

DELTAS = {"action": [0, 1, 2, 3, 4, 5], "observation.state": [-1, 0], "observation.images.front": [-2, 0]}
CAMERA = "observation.images.front"


@pytest.fixture(scope="module")
def resident(written):
    return ResidentDataset(written)


@pytest.fixture(scope="module")
def lerobot_made(tmp_path_factory):
    """A dataset of LeRobot's own writer: several episodes in one video file."""
    from lerobot.configs.video import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = tmp_path_factory.mktemp("lerobot") / "dataset"
    features = {
        "observation.state": {"dtype": "float32", "shape": (3,), "names": ["a", "b", "c"]},
        "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
        CAMERA: {"dtype": "video", "shape": (SIZE, SIZE, 3), "names": ["height", "width", "channels"]},
    }
    encoder = RGBEncoderConfig(vcodec="h264", preset="ultrafast", crf=20)
    dataset = LeRobotDataset.create("local/t", fps=FPS, root=root, features=features, rgb_encoder=encoder)
    rng = np.random.default_rng(0)
    for _ in range(3):
        for _ in range(7):
            frame = {
                "observation.state": rng.normal(size=3).astype(np.float32),
                "action": rng.normal(size=2).astype(np.float32),
                CAMERA: np.full((SIZE, SIZE, 3), rng.integers(0, 255, 3), np.uint8),
                "task": "lift",
            }
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return root


def assert_same_batches(resident, lerobot, deltas):
    expected = torch.utils.data.default_collate([lerobot[i] for i in range(len(lerobot))])
    batch = resident.sample(np.arange(len(lerobot)), deltas)
    expected.pop("task")
    assert set(batch) == set(expected)
    for key, values in expected.items():
        assert batch[key].dtype == values.dtype, key
        assert torch.equal(batch[key], values), key


@pytest.mark.slow
@pytest.mark.parametrize("deltas", [None, DELTAS])
def test_batches_are_lerobots(resident, written, open_with_lerobot, deltas):
    stamps = {key: [i / FPS for i in window] for key, window in deltas.items()} if deltas else None
    assert_same_batches(resident, open_with_lerobot(written, delta_timestamps=stamps), deltas)


def test_datasets_of_lerobots_writer(lerobot_made, open_with_lerobot):
    stamps = {key: [i / FPS for i in window] for key, window in DELTAS.items()}
    lerobot = open_with_lerobot(lerobot_made, delta_timestamps=stamps)
    assert_same_batches(ResidentDataset(lerobot_made), lerobot, DELTAS)


@pytest.mark.slow
def test_consolidated_copies_hold_the_same_frames(resident, written, tmp_path, open_with_lerobot):
    info = consolidate(written, tmp_path / "big")
    assert len({info.video_file(e, CAMERA) for e in range(info.num_episodes)}) == 1
    copy = ResidentDataset(tmp_path / "big")
    for key, frames in resident.frames.items():
        assert torch.equal(copy.frames[key], frames), key
    assert info.episode_metadata == resident.info.episode_metadata
    assert info.raw_file(5).exists()
    assert_same_batches(copy, open_with_lerobot(tmp_path / "big"), None)
    with pytest.raises(DatasetError, match="exists already"):
        consolidate(written, tmp_path / "big")


def test_images_beyond_memory_are_mapped(resident, written, tmp_path):
    root = tmp_path / "d"
    shutil.copytree(written, root)
    mapped = ResidentDataset(root, memory_fraction=1e-12)
    cached = list((root / ".cache").iterdir())
    assert len(cached) == 1
    assert torch.equal(mapped.frames[CAMERA], resident.frames[CAMERA])
    modified = cached[0].stat().st_mtime_ns
    again = ResidentDataset(root, memory_fraction=1e-12)
    assert torch.equal(again.sample([3])[CAMERA], resident.sample([3])[CAMERA])
    assert cached[0].stat().st_mtime_ns == modified


def test_channels_last_and_chosen_keys(written):
    dataset = ResidentDataset(written, keys=["action", CAMERA])
    batch = dataset.sample([0, 1], {CAMERA: [0, 1]}, channels_last=True)
    assert set(batch) == {"action", CAMERA, f"{CAMERA}_is_pad"}
    assert batch[CAMERA].shape == (2, 2, SIZE, SIZE, 3)
    assert batch[CAMERA].dtype == torch.uint8
    with pytest.raises(DatasetError, match=r"has no \['observation.images.wrist'\]. It has \['action'"):
        ResidentDataset(written, keys=["observation.images.wrist"])


def test_wrong_questions_are_answered_with_the_valid_ones(resident):
    with pytest.raises(DatasetError, match=r"Unknown features \['actions'\]. Held are \['action'"):
        resident.sample([0], {"actions": [0]})
    with pytest.raises(DatasetError, match=rf"Frame indices go from 0 to {len(resident) - 1}"):
        resident.sample([len(resident)])


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (f"videos/{CAMERA}/chunk-000/file-002.mp4", "file-002.mp4' is truncated or damaged"),
        ("data/chunk-000/file-000.parquet", "data/chunk-000/file-000.parquet' is truncated or damaged"),
        ("meta/episodes/chunk-000/file-000.parquet", "file-000.parquet' is truncated or damaged"),
        ("meta/info.json", "info.json' is truncated or damaged"),
        ("meta/stats.json", "stats.json' is truncated or damaged"),
        ("meta/tasks.parquet", "tasks.parquet' is truncated or damaged"),
    ],
)
def test_truncated_files_are_named(written, tmp_path, file, message):
    root = tmp_path / "d"
    shutil.copytree(written, root)
    cut(root / file)
    with pytest.raises(DatasetError, match=rf"{message}.*Restore it from a copy, or delete the dataset"):
        ResidentDataset(root)
    (root / file).unlink()
    if file != "meta/stats.json":
        with pytest.raises(DatasetError, match=r"missing|no dataset|of 6 episodes are listed"):
            ResidentDataset(root)


def test_missing_frames_are_noticed(written, tmp_path):
    root = tmp_path / "d"
    shutil.copytree(written, root)
    lengths = DatasetInfo.open(root).episode_lengths
    videos = root / f"videos/{CAMERA}/chunk-000"
    shutil.copy(videos / f"file-{lengths.argmin():03d}.mp4", videos / f"file-{lengths.argmax():03d}.mp4")
    with pytest.raises(DatasetError, match=rf"lacks some of the {lengths.max()} wanted"):
        ResidentDataset(root)


@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=5),
    window=st.lists(st.integers(-8, 8), min_size=1, max_size=5),
    data=st.data(),
)
def test_windows_stay_inside_the_episode(lengths, window, data):
    ends = np.cumsum(lengths)
    episode = data.draw(st.integers(0, len(lengths) - 1))
    start, end = int(ends[episode] - lengths[episode]), int(ends[episode])
    frame = data.draw(st.integers(start, end - 1))
    rows, is_pad = clamp_window(np.array([frame]), window, np.array([start]), np.array([end]))
    # LeRobot's DatasetReader._get_query_indices, in its own words.
    assert rows[0].tolist() == [max(start, min(end - 1, frame + delta)) for delta in window]
    assert is_pad[0].tolist() == [(frame + delta < start) | (frame + delta >= end) for delta in window]


class TestSampler:
    def test_chosen_episodes_without_their_last_frames(self, written):
        info = DatasetInfo.open(written)
        sampler = EpisodeAwareSampler(info, batch_size=1, seed=0, episodes=[1, 4], drop_last_frames=2)
        frames = {int(sampler.next_batch()[0]) for _ in range(sampler.num_frames)}
        starts, ends = info.episode_starts, info.episode_ends
        assert frames == {*range(starts[1], ends[1] - 2), *range(starts[4], ends[4] - 2)}
