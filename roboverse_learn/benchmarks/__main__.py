"""``python -m roboverse_learn.benchmarks <name>``: one measurement, in this process, on one core."""

import logging
import os
import sys

from envs.errors import RoboVerseError
from roboverse_learn.benchmarks import BENCHMARKS

_TASK = "PickCube"
_NEED_A_TASK = ("step", "render")


def main(name: str) -> int:
    """Logs the measurement to the standard output; returns the exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log = logging.getLogger("roboverse_learn.benchmarks")
    log.setLevel(logging.INFO)
    # Libraries read these once, when they are imported: no benchmark has been imported yet.
    os.environ.setdefault("MUJOCO_GL", "osmesa")
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    try:
        measure = BENCHMARKS.get(name)
        log.info("%s", measure(_TASK) if name in _NEED_A_TASK else measure())
    except RoboVerseError as error:
        log.info("%s", error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
