"""Keeps the tests offline, quiet and on few threads, and begins with the longest files."""

import functools
import gc
import importlib.metadata
import os
import re
import signal
import sys
from collections.abc import Generator
from multiprocessing import forkserver
from typing import Any

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from envs.core.machine import scheduling_kept
from tests import imported_process

os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Many processes import the same libraries: without their bytecode, every one compiles them for seconds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# What is installed stays: MuJoCo Warp reads MuJoCo's version for 10 ms with every model, and each of two
# libraries looks through the files of all distributions for a second.
importlib.metadata.version = functools.cache(importlib.metadata.version)
importlib.metadata.packages_distributions = functools.cache(importlib.metadata.packages_distributions)
# Imports leave nothing to collect, and a look at all they have brought takes longer with each.
gc.disable()


def pytest_configure() -> None:
    """Lets a test be interrupted where a shell began all of them in its background, which ignores Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup() -> Generator[None, Any, Any]:
    """Keeps LeRobot's encoder, where it writes in a fixture, from making all later tests real-time."""
    with scheduling_kept():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, Any, Any]:
    """Keeps LeRobot's encoder, where it writes in a test, from making all later tests real-time."""
    with scheduling_kept():
        return (yield)


ON_REQUEST = {"long", "gpu"}
"""Markers of tests that run only where ``-m`` names them."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselects tests of markers that ``-m`` does not name, and puts files with a slow test first.

    A slow file that starts last would keep one core busy at the end. xdist would begin with the files of
    most tests; ``--no-loadscope-reorder`` keeps it from that.
    """
    unasked = ON_REQUEST.difference(re.findall(r"\w+", config.option.markexpr))
    deselected = [item for item in items if any(item.get_closest_marker(name) for name in unasked)]
    if deselected:
        config.hook.pytest_deselected(items=deselected)
        gone = set(deselected)
        items[:] = [item for item in items if item not in gone]
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture
def forked_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forks the workers of a collection, for tests of something else: new interpreters import for seconds."""
    # A pool blocks SIGINT while its workers start: a fork server that began there would pass that on to all.
    forkserver.ensure_running()
    monkeypatch.setattr(
        "roboverse_learn.data.collection.pool.get_context", lambda _: imported_process.CONTEXT
    )


def pytest_collection_finish() -> None:
    """What has been imported by now stays: a million objects that no collection need look at again."""
    gc.collect()
    gc.freeze()
    gc.enable()


TOGETHER = ("tests/integration/", "tests/roboverse_learn/training/rl/ppo/")
"""Folders whose files one process tests: they share one run of ours, or libraries that import for seconds."""


class _ByFile(LoadFileScheduling):
    """A file is tested by one process; all files of some folders are too."""

    def _split_scope(self, nodeid: str) -> str:
        shared = next((folder for folder in TOGETHER if nodeid.startswith(folder)), None)
        return shared or super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> _ByFile | None:
    return _ByFile(config, log) if config.getoption("dist") == "loadfile" else None
