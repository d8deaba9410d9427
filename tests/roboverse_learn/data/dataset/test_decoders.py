"""Processes that decode videos: when the memory that they write to is closed."""

import contextlib
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset import decoders
from roboverse_learn.data.dataset.decoders import Decoders
from roboverse_learn.data.shared_images import to_fill

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux shares images")

JOBS = [(Path(str(index)), np.zeros(1), np.zeros(1, np.int64)) for index in range(30)]


@pytest.fixture
def closed(monkeypatch):
    """Calls that are made when the memory is closed."""
    calls = []

    @contextlib.contextmanager
    def watched(shapes):
        with to_fill(shapes) as places:
            try:
                yield places
            finally:
                for call in calls:
                    call()

    monkeypatch.setattr(decoders, "to_fill", watched)
    return calls


def decode():
    with Decoders(100_000, 3) as used:
        used.decode({"front": (30, 3, 2, 2)}, {"front": JOBS})


@pytest.mark.parametrize("error", [DatasetError, KeyboardInterrupt])
def test_memory_is_closed_only_after_all_jobs_have_ended_also_after_an_error(monkeypatch, closed, error):
    begun, ended, at_closing, together = [], [], [], threading.Barrier(3)

    def decode_video(path, *_):
        begun.append(path)
        with contextlib.suppress(threading.BrokenBarrierError):
            together.wait()
        if path == Path("0"):
            together.abort()
            ended.append(path)
            raise error("damaged")
        time.sleep(0.2)
        ended.append(path)

    monkeypatch.setattr(decoders, "ProcessPoolExecutor", lambda count, *_: ThreadPoolExecutor(count))
    monkeypatch.setattr(decoders, "decode_video", decode_video)
    closed.append(lambda: at_closing.append((sorted(begun), sorted(ended))))
    with pytest.raises(error, match="damaged"):
        decode()
    (counts,) = at_closing
    assert counts[0] == counts[1] and len(counts[0]) < len(JOBS)
    assert sorted(begun) == counts[0], "what waits for a thread is cancelled"


def test_memory_is_closed_only_after_the_other_processes_of_one_that_died(monkeypatch, closed):
    happened = []

    class Pool:
        def submit(self, *_):
            future = Future()
            future.set_exception(BrokenProcessPool())
            return future

        def shutdown(self, **_):
            happened.append("shut down")

    monkeypatch.setattr(decoders, "ProcessPoolExecutor", lambda *_: Pool())
    closed.append(lambda: happened.append("closed"))
    with pytest.raises(DatasetError, match="A process that decodes videos died"):
        decode()
    assert happened[:2] == ["shut down", "closed"]
