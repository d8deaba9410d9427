"""Every simulator can be launched and closed as often as one likes: nothing stays behind."""

import ctypes
import gc
import os
import threading
import warnings
from dataclasses import dataclass
from pathlib import Path

import pytest

from envs.core.errors import MissingExtraError, SimulatorError
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, ScenarioCfg
from envs.simulators import HANDLERS

LIBC = ctypes.CDLL(None)
FEW, MANY = 30, 1000
WINDOW = 15
MAX_GROWTH_MIB = 16.0
"""What an allocator may keep, however many launches there were: less than 16 KiB a launch of a thousand."""

SCENE = ScenarioCfg(
    objects=(
        ObjectCfg(
            name="ball", geoms=(GeomCfg(shape="sphere", size=(0.05,), mass_kg=0.1),), pos=(0.0, 0.0, 0.2)
        ),
        ObjectCfg(
            name="block",
            geoms=(GeomCfg(shape="box", size=(0.05, 0.05, 0.05), mass_kg=0.1),),
            pos=(0.2, 0.0, 0.2),
        ),
    ),
    cameras=(CameraCfg(name="front", pos=(1.0, 0.0, 0.5), look_at=(0.0, 0.0, 0.1), width=16, height=16),),
    room=None,
)


@dataclass(frozen=True)
class Use:
    """What a process holds."""

    memory_mib: float
    files: int
    threads: int

    @classmethod
    def now(cls) -> "Use":
        gc.collect()
        LIBC.malloc_trim(0)  # gives back what is free already
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(
            memory_mib=pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
            files=len(os.listdir("/proc/self/fd")),
            threads=threading.active_count(),
        )


def launch(name, times, *, draw=False):
    """Returns the least that was held after any of the last launches: what is freed late is no leak.

    What a simulator's own packages warn of, pytest would keep for its report, a piece with each launch.
    """
    uses = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for index in range(times):
            with HANDLERS.get(name)(SCENE, 2) as handler:
                handler.launch()
                handler.step(3)
                if draw:
                    handler.render()
            if index >= times - WINDOW:
                uses.append(Use.now())
    return Use(*(min(getattr(use, field) for use in uses) for field in Use.__annotations__))


SLOW = {"genesis", "mujoco_warp"}
"""Simulators whose launches take seconds, made only on demand."""


@pytest.fixture(
    params=[pytest.param(name, marks=pytest.mark.long) if name in SLOW else name for name in HANDLERS.names()]
)
def name(request):
    try:
        HANDLERS.get(request.param)
    except MissingExtraError as error:
        pytest.skip(str(error))
    return request.param


def assert_nothing_stays(name, times, **options):
    launch(name, 1, **options)
    gc.freeze()  # what is there by now, a million of objects, would be looked at in every collection
    before = launch(name, 2 * WINDOW, **options)  # the first ones load what stays
    after = launch(name, times, **options)
    print(f"{name}: {before} before and {after} after {times} launches {options or ''}")
    assert after.memory_mib - before.memory_mib < MAX_GROWTH_MIB
    assert after.files <= before.files
    assert after.threads <= before.threads


@pytest.mark.slow
def test_a_few_launches_leave_nothing_behind(name):
    assert_nothing_stays(name, FEW)


@pytest.mark.long
def test_a_thousand_launches_leave_nothing_behind(name):
    assert_nothing_stays(name, MANY)


@pytest.mark.long
def test_images_leave_nothing_behind(name):
    try:
        assert_nothing_stays(name, 2 * FEW, draw=True)
    except SimulatorError as error:  # nothing to draw with
        pytest.skip(str(error))
