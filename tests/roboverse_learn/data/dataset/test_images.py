import shutil
import sys
import threading

import numpy as np
import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.dataset import images
from roboverse_learn.data.dataset.images import load_images

pytestmark = pytest.mark.slow


@pytest.fixture
def by_processes(monkeypatch):
    if sys.platform != "linux":
        pytest.skip("only Linux shares images")
    monkeypatch.setattr(images, "FRAMES_A_PROCESS", 5)
    used = []
    original = images._decoded_by_processes

    def counted(info, shapes, count):
        used.append(count)
        return original(info, shapes, count)

    monkeypatch.setattr(images, "_decoded_by_processes", counted)
    return used


def test_processes_decode_what_threads_decode(written, by_processes, monkeypatch):
    info = DatasetInfo.open(written)
    found = load_images(info, info.camera_keys, 0.5, num_threads=3)
    assert by_processes == [3]
    monkeypatch.setattr(images, "FRAMES_A_PROCESS", 10_000)
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
