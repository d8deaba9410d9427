"""How long a command that does nothing takes: what a user waits for a list or a help text."""

import subprocess
import sys
import time
from statistics import median

from benchmark.throughput import Measurement


def measure_startup(turns: int = 5) -> Measurement:
    """Compares ``roboverse list`` to a Python program that ends at once.

    Args:
        turns: How often either is timed, after one that warms the disk's cache.
    """
    ours = [_time(["-m", "roboverse_learn.cli", "list"]) for _ in range(turns + 1)][1:]
    empty = [_time(["-c", ""]) for _ in range(turns + 1)][1:]
    return Measurement(
        name="roboverse list / an empty Python program",
        ours_s=median(ours),
        baseline_s=median(empty),
        ratio=median(ours) / median(empty),
        goal="goal: ours below 1000 ms",
    )


def _time(arguments: list[str]) -> float:
    started = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started
