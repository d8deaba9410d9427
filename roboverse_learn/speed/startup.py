"""How long a command that does nothing takes: ``python -m roboverse_learn.speed.startup``."""

import logging
import subprocess
import sys
import time
from collections.abc import Sequence
from statistics import median

from envs.core.arguments import NoSettings, run_program
from roboverse_learn.speed.throughput import Measurement

log = logging.getLogger(__name__)

GOAL_S = 1.0


def measure_startup(words: tuple[str, ...], turns: int = 5) -> Measurement:
    """Compares a command to a Python program that ends at once.

    Args:
        words: Words of the command, such as ``("list",)``.
        turns: How often either is timed, after one turn that warms the disk's cache.
    """
    times = [(_time("-m", "roboverse_learn.cli", *words), _time("-c", "")) for _ in range(turns + 1)][1:]
    ours, empty = (median(column) for column in zip(*times, strict=True))
    return Measurement(
        name=f"roboverse {' '.join(words)} / an empty Python program",
        ours_s=ours,
        baseline_s=empty,
        ratio=ours / empty,
        goal=f"goal: ours ≤ {1e3 * GOAL_S:.0f} ms",
    )


def _time(*arguments: str) -> float:
    started = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def main(words: Sequence[str] | None = None) -> int:
    """Logs both measurements; the exit code is 1 where a goal is missed."""
    return run_program("python -m roboverse_learn.speed.startup", NoSettings, _measure_all, words)


def _measure_all(_: NoSettings) -> int:
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    measurements = [measure_startup(words) for words in (("list",), ("--help",))]
    for measurement in measurements:
        log.info("%s", measurement)
    return int(any(measurement.ours_s > GOAL_S for measurement in measurements))


if __name__ == "__main__":
    sys.exit(main())
