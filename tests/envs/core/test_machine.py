"""How processes share the cores of a machine."""

import os
import re
import subprocess
import sys

import pytest

from envs.core.machine import keep_freed_memory, scheduling_kept

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux's scheduler, GNU's runtime")
_LIBRARIES = """
import ctypes, importlib.util, pathlib
import roboverse_learn
torch = pathlib.Path(importlib.util.find_spec("torch").origin).parent
ctypes.CDLL(str(next(torch.glob("lib/libgomp*"))))  # reads the environment; torch would load it
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "spins"),
    [({}, 5000), ({"GOMP_SPINCOUNT": "1234"}, 1234), ({"OMP_WAIT_POLICY": "ACTIVE"}, 30_000_000_000)],
)
def test_waiting_threads_of_torch_sleep_unless_the_user_has_set_otherwise(given, spins):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_", "KMP_"))}
    done = subprocess.run(
        [sys.executable, "-c", _LIBRARIES],
        env=kept | {"OMP_DISPLAY_ENV": "VERBOSE"} | given,
        capture_output=True,
        text=True,
        check=True,
    )
    found = re.search(r"GOMP_SPINCOUNT = '(\d+)'", done.stderr)
    assert found, done.stderr
    assert int(found[1]) == spins


def test_a_thread_keeps_its_scheduling_whatever_a_library_sets():
    before = os.sched_getscheduler(0)
    with pytest.raises(ValueError, match="of the library"), scheduling_kept():
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        raise ValueError("of the library")
    assert os.sched_getscheduler(0) == before != os.SCHED_BATCH


def test_memory_that_a_step_frees_is_there_for_the_next(monkeypatch):
    import resource

    import torch

    def page_faults_of_a_step() -> int:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        tensors = [torch.ones(3 << 18) for _ in range(48)]  # 144 MB in pieces of 3 MB, which glibc gives back
        del tensors
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    for name in [name for name in os.environ if name.startswith(("MALLOC_", "GLIBC_TUNABLES"))]:
        monkeypatch.delenv(name)
    keep_freed_memory()
    assert min(page_faults_of_a_step() for _ in range(3)) < 144 * 256 / 10


@pytest.mark.parametrize("name", ["MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES"])
def test_the_users_settings_of_memory_are_kept(name, monkeypatch):
    import ctypes

    monkeypatch.setenv(name, "1")
    monkeypatch.setattr(ctypes, "CDLL", lambda _: pytest.fail("the user's settings were changed"))
    keep_freed_memory()
