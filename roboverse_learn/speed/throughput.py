"""Speed as ratios to a named baseline, both timed in one run: ``python -m roboverse_learn.speed.throughput``.

A time says as much of the machine as of the code; a ratio of two times, taken in turns on one core of
one machine, says something of the code.
"""

import ctypes.util
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.errors import RoboVerseError, SimulatorError

if TYPE_CHECKING:
    from envs.simulators.base import Handler

logger = logging.getLogger(__name__)

IMAGE_SIZE = 128


@dataclass(frozen=True, kw_only=True, slots=True)
class ThroughputBenchmark:
    """``python -m roboverse_learn.speed.throughput``: env.step and a picture, each against its baseline.

    Attributes:
        task: Registered task.
        turns: How often either of two is timed.
    """

    task: str = "PickCube"
    turns: int = 15


@dataclass(frozen=True, kw_only=True, slots=True)
class Measurement:
    """Two times of one run.

    Attributes:
        name: What was compared.
        ours_s: Median time of ours.
        baseline_s: Median time of the baseline.
        ratio: Median over the turns of ours over the baseline's, or of its inverse for a speed-up.
        goal: What is to be reached, for people.
    """

    name: str
    ours_s: float
    baseline_s: float
    ratio: float
    goal: str

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.ratio:.2f}  ({self.goal}; ours {1e3 * self.ours_s:.3f} ms, "
            f"baseline {1e3 * self.baseline_s:.3f} ms)"
        )


def measure_step(task: str, *, turns: int = 15, num_steps: int = 100, visuals: bool = True) -> Measurement:
    """Compares ``env.step`` of one env with state observations to a bare ``mj_step`` loop.

    Both take the same actions from the same states, and must end where the other ends.

    Args:
        task: Task.
        turns: How often either is timed.
        num_steps: Control steps per turn.
        visuals: Whether the loop steps the scene as it is, or what the env steps: it without what is only
            seen, which moves alike and takes a tenth less time.

    Returns:
        Seconds per control step; the ratio is ours over the baseline's.

    Raises:
        SimulatorError: The two did not end in the same state, so it was not the same physics.
    """
    import mujoco

    from envs import RoboVerseEnv

    env = RoboVerseEnv(task, split="test", observation="state", num_threads=1)
    handler: Any = env.batch.handler  # MuJoCo's, whose model is not part of the interface
    model = handler.model if visuals else handler.physics_model
    data = mujoco.MjData(model)
    decimation = env.batch.scenario.physics.decimation
    rest = np.array(env.batch.scenario.robots[0].default_qpos)
    phase = np.arange(num_steps)[:, None] / 10
    actions = (rest + 0.1 * np.sin(phase + np.arange(len(rest)))).astype(np.float32)
    actions = np.clip(actions, *model.actuator_ctrlrange.T)
    share = np.arange(1, decimation + 1)[:, None] / decimation
    begin = np.concatenate([[rest], actions[:-1]])
    way = begin[:, None] * (1.0 - share) + actions[:, None] * share  # (num_steps, decimation, nu)

    def ours() -> None:
        for action in actions:
            env.step(action)

    def bare() -> None:
        for targets in way.reshape(-1, way.shape[-1]):
            data.ctrl[:] = targets
            mujoco.mj_step(model, data)

    times = []
    for turn in range(turns + 1):
        env.reset(options={"episode": int(env.batch.split_indices[turn])})
        handler.set_joint_targets({env.batch.scenario.robots[0].name: rest[None]})
        (start,) = handler.snapshot()
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = start.qpos, start.mocap_pos, start.mocap_quat
        times.append(_in_turns(ours, bare, first=turn % 2))
        (end,) = handler.snapshot()
        if not np.allclose(end.qpos, data.qpos, atol=1e-8):
            raise SimulatorError(
                f"env.step and mj_step ended {np.abs(end.qpos - data.qpos).max():.2g} apart: this is not the "
                "same physics."
            )
    env.close()
    mine, theirs = np.array(times[1:]).T / num_steps  # the first turn warms up
    return Measurement(
        name=f"env.step (1 env, state) / bare mj_step loop{'' if visuals else ' without visuals'}",
        ours_s=median(mine),
        baseline_s=median(theirs),
        ratio=median(mine / theirs),
        goal="goal ≤ 1.10",
    )


def measure_render(task: str, *, turns: int = 15) -> Measurement:
    """Compares a picture by the default renderer to the same one by MuJoCo's GL, software-rendered.

    The baseline draws the robot's meshes as they come; ours are simplified. One core, shadows on.

    Args:
        task: Task.
        turns: How often either is timed.

    Returns:
        Seconds per picture; the ratio is the baseline's time over ours.

    Raises:
        SimulatorError: OSMesa is not installed, or another GL was chosen.
    """
    if os.environ.get("MUJOCO_GL") != "osmesa":
        raise SimulatorError("MUJOCO_GL is not 'osmesa'; the baseline is a software rasterizer on one core.")
    if ctypes.util.find_library("OSMesa") is None:
        raise SimulatorError("libOSMesa is not installed; on Debian and Ubuntu: apt-get install libosmesa6.")
    ours = _handler(task, "warp", simplify_meshes=True)
    baseline = _handler(task, "gl", simplify_meshes=False)
    times = [_in_turns(ours.render, baseline.render, first=turn % 2) for turn in range(turns + 1)]
    ours.close()
    baseline.close()
    mine, theirs = np.array(times[1:]).T
    return Measurement(
        name=f"RGB {IMAGE_SIZE}×{IMAGE_SIZE}, MuJoCo GL (OSMesa) / warp",
        ours_s=median(mine),
        baseline_s=median(theirs),
        ratio=median(theirs / mine),
        goal="goal ≥ 10",
    )


def _handler(task: str, renderer: str, *, simplify_meshes: bool) -> "Handler":
    """Returns a handler with one env at the first test episode's start, under a light with shadows."""
    from envs import make_vec

    with_looks = make_vec(task, 1, split="test", image_size=IMAGE_SIZE)
    episode = int(with_looks.split_indices[0])
    with_looks.reset_envs([0], [episode])
    looks = with_looks.randomizer.appearance(episode)
    lights = (replace(looks.lights[0], cast_shadow=True), *looks.lights[1:])
    build: Any = type(with_looks.handler)
    handler = build(
        with_looks.scenario,
        1,
        renderer=renderer,
        num_threads=1,
        textures=with_looks.randomizer.library.texture,
        simplify_meshes=simplify_meshes,
    )
    handler.launch()
    handler.set_states(with_looks.get_states())
    handler.set_appearance(replace(looks, lights=lights), 0)
    with_looks.close()
    return handler


def _in_turns(
    ours: Callable[[], object], baseline: Callable[[], object], *, first: int
) -> tuple[float, float]:
    """Times both, whichever ``first`` says before the other: a machine that slows down slows both."""
    seconds = [0.0, 0.0]
    for which in (first, 1 - first):
        started = time.perf_counter()
        (ours, baseline)[which]()
        seconds[which] = time.perf_counter() - started
    return seconds[0], seconds[1]


def main(words: Sequence[str] | None = None) -> int:
    """Prints every measurement, or why it could not be taken."""
    return run_program("python -m roboverse_learn.speed.throughput", ThroughputBenchmark, _measure_all, words)


def _measure_all(given: ThroughputBenchmark) -> int:
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    # Both are read once, when MuJoCo and its threads start: set them before the first import.
    os.environ.setdefault("MUJOCO_GL", "osmesa")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    failed = False
    measures = (measure_step, partial(measure_step, visuals=False), measure_render)
    for measure in measures:
        try:
            logger.info("%s", measure(given.task, turns=given.turns))
        except RoboVerseError as error:
            failed = True
            name = measure.func.__name__ if isinstance(measure, partial) else measure.__name__
            logger.info("%s: not measured. %s", name, error)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
