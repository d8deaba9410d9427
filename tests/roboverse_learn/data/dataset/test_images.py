import re
import shutil
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from envs.core.errors import DatasetError, LockedError
from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.dataset import decoders, images
from roboverse_learn.data.dataset.decoders import Decoders
from roboverse_learn.data.dataset.images import damaged_videos, load_images
from roboverse_learn.folder_lock import lock_directory

pytestmark = pytest.mark.slow


@pytest.fixture
def by_processes(monkeypatch):
    if sys.platform != "linux":
        pytest.skip("only Linux shares images")
    monkeypatch.setattr(decoders, "FRAMES_A_PROCESS", 5)
    used = []
    original = Decoders.decode

    def counted(self, shapes, jobs):
        used.append(self.count)
        return original(self, shapes, jobs)

    monkeypatch.setattr(Decoders, "decode", counted)
    return used


def test_processes_decode_what_threads_decode(written, by_processes, monkeypatch):
    info = DatasetInfo.open(written)
    found = load_images(info, info.camera_keys, 0.5, num_threads=3)
    assert by_processes == [3]
    monkeypatch.setattr(decoders, "FRAMES_A_PROCESS", 10_000)
    expected = load_images(info, info.camera_keys, 0.5, num_threads=3)
    assert by_processes == [3]
    assert list(found) == list(expected) == list(info.camera_keys)
    for key, values in expected.items():
        np.testing.assert_array_equal(found[key], values)
        found[key][0] = 0  # torch needs writable memory


def test_two_cores_decode_by_threads(written, by_processes):
    info = DatasetInfo.open(written)
    load_images(info, info.camera_keys, 0.5, num_threads=2)
    assert by_processes == []


def test_a_damaged_video_that_a_process_decodes_is_named(written, by_processes, tmp_path):
    copy = shutil.copytree(written, tmp_path / "copy")
    info = DatasetInfo.open(copy)
    video = info.video_file(3, info.camera_keys[0])
    video.write_bytes(video.read_bytes()[:200])
    before = threading.active_count()
    with pytest.raises(DatasetError, match=video.name):
        load_images(info, info.camera_keys, 0.5, num_threads=3)
    assert by_processes == [3]
    assert threading.active_count() == before


def test_every_damaged_video_is_named_without_decoding_one(written, tmp_path, monkeypatch):
    monkeypatch.setattr(images, "decode_video", None)
    assert damaged_videos(DatasetInfo.open(written)) == []
    info = DatasetInfo.open(shutil.copytree(written, tmp_path / "copy"))
    files = [info.video_file(episode, info.camera_keys[0]) for episode in range(info.num_episodes)]
    lengths = list(info.episode_lengths)
    short, long = lengths.index(min(lengths)), lengths.index(max(lengths))
    missing, empty, cut, folder = (index for index in range(6) if index not in (short, long))
    said = {
        long: rf"it holds {lengths[short]} frames and lacks some of the {lengths[long]} wanted\). Restore",
        missing: r"is missing\. Restore it",
        empty: r"truncated or damaged \(Invalid data found when processing input\)\. Restore it",
        cut: r"truncated or damaged \(End of file\)\. Restore it",
        folder: r"truncated or damaged \(it is a folder\)\. Restore it",
    }
    files[long].write_bytes(files[short].read_bytes())
    files[missing].unlink()
    files[empty].write_bytes(b"")
    files[cut].write_bytes(files[cut].read_bytes()[:-200])
    files[folder].unlink()
    files[folder].mkdir()
    found = damaged_videos(info)
    assert len(found) == len(said)
    for (index, words), error in zip(sorted(said.items()), found, strict=True):
        assert f"{files[index]}'" in str(error) and re.search(words, str(error)), error


@pytest.fixture
def locks(monkeypatch):
    """The locks that are taken; kept, since one that nobody has is released."""
    taken = []

    def take(*args, **options):
        taken.append(lock_directory(*args, **options))
        return taken[-1]

    monkeypatch.setattr(images, "lock_directory", take)
    return taken


def test_no_process_writes_to_a_dataset_whose_images_are_decoded_to_a_file(
    written, tmp_path, monkeypatch, locks
):
    info = DatasetInfo.open(shutil.copytree(written, tmp_path / "copy"))
    key, decode, refused = info.camera_keys[0], images._decode, []

    def decode_while_another_tries(*args):
        with pytest.raises(LockedError):
            lock_directory(info.root)
        refused.append(True)
        decode(*args)

    monkeypatch.setattr(images, "_decode", decode_while_another_tries)
    load_images(info, [key], 1e-12, num_threads=2)
    assert refused == [True]
    assert [lock.is_locked for lock in locks] == [False]
    lock_directory(info.root).release()


def test_images_that_two_programs_want_at_once_are_decoded_once(written, tmp_path, monkeypatch):
    info = DatasetInfo.open(shutil.copytree(written, tmp_path / "copy"))
    key, decode, decoded = info.camera_keys[0], images._decode, []

    def count(*args):
        decoded.append(True)
        decode(*args)

    monkeypatch.setattr(images, "_decode", count)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: load_images(info, [key], 1e-12, num_threads=1)[key], range(2))
    assert decoded == [True]
    np.testing.assert_array_equal(first, second)


def test_the_lock_of_a_dataset_is_released_when_decoding_fails(written, tmp_path, locks):
    info = DatasetInfo.open(shutil.copytree(written, tmp_path / "copy"))
    key = info.camera_keys[0]
    video = info.video_file(0, key)
    video.write_bytes(video.read_bytes()[:200])
    with pytest.raises(DatasetError, match=video.name):
        load_images(info, [key], 1e-12, num_threads=1)
    assert [lock.is_locked for lock in locks] == [False]
    lock_directory(info.root).release()
