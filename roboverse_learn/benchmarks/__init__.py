"""The speed of the parts, each as a ratio to a named reference that is timed in the same run."""

import subprocess
import sys

from envs.errors import SimulatorError
from envs.registry import Registry

BENCHMARKS: Registry = Registry("benchmark")
BENCHMARKS.add(
    "step", "benchmark.throughput:measure_step", summary="env.step / bare mj_step loop (goal ≤ 1.10)"
)
BENCHMARKS.add(
    "render",
    "benchmark.throughput:measure_render",
    summary="RGB 128×128 on one core, MuJoCo's GL (OSMesa) / ours (goal ≥ 10; needs libosmesa6)",
)
BENCHMARKS.add(
    "write",
    "roboverse_learn.benchmarks.dataset:measure_write",
    summary="writing demonstrations, LeRobot's writer / ours (goal ≥ 3)",
)
BENCHMARKS.add(
    "read",
    "roboverse_learn.benchmarks.dataset:measure_read",
    summary="training batches, LeRobot's loader / ours (goal ≥ 10)",
)
BENCHMARKS.add(
    "startup",
    "roboverse_learn.benchmarks.startup:measure_startup",
    summary="roboverse list / an empty Python program (goal: below 1 s)",
)


def run(name: str) -> str:
    """Takes one measurement in a process of its own, which is bound to one core from its start.

    Args:
        name: Registered benchmark.

    Returns:
        The line to print.

    Raises:
        SimulatorError: The measurement could not be taken; the message says why.
    """
    done = subprocess.run(
        [sys.executable, "-m", "roboverse_learn.benchmarks", name],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = done.stdout.strip().splitlines()
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or lines or ["no reason given"])[-1]
        raise SimulatorError(f"The benchmark '{name}' could not be run. {reason}")
    return lines[-1]
