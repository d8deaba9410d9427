"""How processes share the cores of a machine."""

import os
import re
import subprocess
import sys

import pytest

from envs.core.machine import scheduling_kept

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
