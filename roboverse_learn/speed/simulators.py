"""Every installed simulator behind its handler against its own Python loop.

Ours takes targets, steps, and gives the states of all robots and objects; the loop works with the same scene
as a script on that simulator alone would (:mod:`roboverse_learn.speed.loops`). Overhead is a ratio of
processor time, which a busy machine hardly changes.
"""

import dataclasses
import logging
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import numpy as np

from envs.core.arguments import parse
from envs.core.errors import MissingExtraError, RoboVerseError, SimulatorError, unknown_name
from roboverse_learn.speed.loops import LOOPS
from roboverse_learn.speed.throughput import Measurement

log = logging.getLogger(__name__)

TASK = "PickCube"
OVERHEAD_GOAL = 1.15


def measure_overhead(simulator: str, *, turns: int = 11, control_steps: int = 20) -> Measurement:
    """Compares control steps of one environment to the simulator's own loop over the same scene.

    Returns:
        Processor seconds per control step; the ratio is ours over the loop's.

    Raises:
        UnknownNameError: if there is no such simulator.
        MissingExtraError: if it is not installed.
        SimulatorError: The two did not end in the same state, so it was not the same physics.
    """
    from envs.simulators import HANDLERS
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = task.scenario
    states = task.initial_state([np.random.default_rng(0)])
    robot, decimation = scenario.robots[0].name, scenario.physics.decimation
    start = states.robots[robot].joint_pos.numpy()
    low, high = np.array([joint.range for joint in scenario.robots[0].joints]).T
    targets = [np.clip(start + 0.05 * np.sin(0.3 * step), low, high) for step in range(control_steps)]
    build: Any = HANDLERS.get(simulator)
    handler, scene = (build(scenario, 1, renderer="warp", num_threads=1) for _ in range(2))
    with handler, scene:
        for one in (handler, scene):
            one.launch()
        loop = LOOPS[simulator](scene, robot)

        def ours() -> None:
            for target in targets:
                handler.set_joint_targets({robot: target})
                handler.step(decimation)
                handler.get_states()

        def theirs() -> None:
            for target in targets:
                loop.run(target[0], decimation)

        times = []
        for turn in range(turns + 1):  # the first turn warms up
            handler.set_states(states)
            handler.step(1)  # what is made anew after a state was set is made now
            loop.begin(states)
            times.append(_in_turns(ours, theirs, turn))
            joints = handler.get_states().robots[robot].joint_pos[0].numpy()
            away = np.abs(np.sort(joints) - np.sort(loop.joints())).max()
            if away > 1e-5:
                raise SimulatorError(f"The joints ended {away:.2g} apart: this is not the same physics.")
    seconds = np.array(times[1:]) / control_steps
    return Measurement(
        name=f"{simulator}: control step of {TASK}, handler / the simulator's own loop",
        ours_s=median(seconds[:, 0]),
        baseline_s=median(seconds[:, 1]),
        ratio=median(seconds[:, 0] / seconds[:, 1]),
        goal=f"goal ≤ {OVERHEAD_GOAL:.2f}",
    )


def _in_turns(ours: Callable[[], object], theirs: Callable[[], object], turn: int) -> tuple[float, float]:
    seconds = [0.0, 0.0]
    for which in (turn % 2, 1 - turn % 2):
        started = time.process_time()
        (ours, theirs)[which]()
        seconds[which] = time.process_time() - started
    return seconds[0], seconds[1]


def measure(names: Sequence[str], *, turns: int) -> bool:
    """Logs the measurements of the simulators named; one that is not installed is said to be absent.

    Returns:
        Whether every overhead that was measured reaches its goal, and at least one was measured.
    """
    reached: list[bool] = []
    for name in names:
        try:
            overhead = measure_overhead(name, turns=turns)
            reached.append(overhead.ratio <= OVERHEAD_GOAL)
            log.info("%s", overhead)
        except MissingExtraError as error:
            log.info("%s: not measured. %s", name, error)
        except RoboVerseError as error:
            reached.append(False)
            log.info("%s: not measured. %s", name, error)
    return bool(reached) and all(reached)


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """What to measure.

    Attributes:
        simulators: Registered simulators, as in simulators=[mujoco,sapien]; all that have a loop by default.
        turns: How often either side is timed.
    """

    simulators: tuple[str, ...] = tuple(LOOPS)
    turns: int = 11


def main(words: Sequence[str] | None = None) -> int:
    """Logs all measurements; the exit code is 1 where an overhead misses its goal."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    try:
        settings = parse("python -m roboverse_learn.speed.simulators", Settings, words)
        for name in settings.simulators:
            if name not in LOOPS:
                raise unknown_name("simulator with a loop of its own", name, LOOPS)
    except RoboVerseError as error:
        log.error("%s", error)
        return 2
    return int(not measure(settings.simulators, turns=settings.turns))


if __name__ == "__main__":
    sys.exit(main())
