"""The speed of the parts, each as a ratio to a named reference that is timed in the same run."""

import subprocess
import sys
from collections.abc import Sequence

from envs.core.registry import Registry

BENCHMARKS: Registry[str] = Registry("benchmark")
"""Names to modules, each of which is a program: threads and GL are set before a simulator is imported."""

BENCHMARKS.add(
    "throughput",
    "roboverse_learn.speed.throughput",
    summary="env.step against a bare mj_step loop; a picture against MuJoCo's GL (needs libosmesa6)",
)
BENCHMARKS.add(
    "dataset",
    "roboverse_learn.speed.dataset",
    summary="writing demonstrations and reading batches, against LeRobot's own",
)
BENCHMARKS.add(
    "evaluation",
    "roboverse_learn.speed.evaluation",
    summary="evaluating one ACT checkpoint on the same episodes, against LeRobot's evaluation",
)
BENCHMARKS.add(
    "mujoco_warp",
    "roboverse_learn.speed.mujoco_warp",
    summary="simulator=mujoco_warp against bare mujoco_warp: physics and pictures (wants a GPU)",
)
BENCHMARKS.add(
    "simulators",
    "roboverse_learn.speed.simulators",
    summary="every installed simulator's handler against its own loop; two processes against one",
)
BENCHMARKS.add(
    "training",
    "roboverse_learn.speed.training",
    summary="a gradient step of ACT and Diffusion Policy, against LeRobot's, and their losses (wants a GPU)",
)
BENCHMARKS.add(
    "rl",
    "roboverse_learn.speed.rl",
    summary="PPO on our env against bare mujoco_warp, adapters, seconds to solve PickCube (wants a GPU)",
)
BENCHMARKS.add(
    "physics",
    "roboverse_learn.speed.physics",
    summary="where the time of mujoco_warp's steps goes: with one thing changed, and by kernel (wants a GPU)",
)
BENCHMARKS.add(
    "startup",
    "roboverse_learn.speed.startup",
    summary="roboverse list, against an empty Python program",
)


def run(name: str, words: Sequence[str] = ()) -> int:
    """Runs one benchmark in a process of its own, which prints what it measured.

    Args:
        name: Registered benchmark.
        words: ``key=value`` words that it reads.

    Returns:
        Its exit code: 1 where a goal was missed or something could not be measured.

    Raises:
        UnknownNameError: if there is no such benchmark.
    """
    module = str(BENCHMARKS.entry(name).target)
    return subprocess.run([sys.executable, "-m", module, *words], check=False).returncode
