"""simulator=sapien against SAPIEN's own Python loop on the same scene, and two processes against one.

Ours takes targets, steps, and gives the states of all environments; the loop sets the same drive targets,
steps the same scenes and reads what a loop of its own would read: joints, cube, hand.
"""

import argparse
import dataclasses
import logging
import sys
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

from benchmark.throughput import Measurement
from envs.errors import RoboVerseError, SimulatorError

log = logging.getLogger(__name__)

TASK = "PickCube"
OVERHEAD_GOAL, SPEEDUP_GOAL = 1.15, 1.7


def measure_overhead(*, num_envs: int = 1, turns: int = 11, control_steps: int = 20) -> Measurement:
    """Compares control steps of the handler to a loop over the same PhysX scenes in one thread.

    Returns:
        Seconds per control step of one environment; the ratio is ours over the loop's.

    Raises:
        SimulatorError: The two did not end in the same state, so it was not the same physics.
    """
    from envs.handlers import HANDLERS
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = task.scenario
    states = task.initial_state([np.random.default_rng(index) for index in range(num_envs)])
    robot, decimation = scenario.robots[0].name, scenario.physics.decimation
    start = states.robots[robot].joint_pos.numpy()
    low, high = np.array([joint.range for joint in scenario.robots[0].joints]).T
    targets = [
        np.clip(start + 0.05 * np.sin(0.3 * step), low, high).astype(np.float32)
        for step in range(control_steps)
    ]
    build: Any = HANDLERS.get("sapien")
    handler = build(scenario, num_envs, renderer="warp", num_threads=1)
    bare = build(scenario, num_envs, renderer="warp", num_threads=1)
    for one in (handler, bare):
        one.launch()
    loop = _Loop(bare, robot)

    def begin() -> None:
        for one in (handler, bare):
            one.set_states(states)
            one.step(1)  # scenes are made anew at the first step after a state was set
        loop.find()

    def ours() -> None:
        for target in targets:
            handler.set_joint_targets({robot: target})
            handler.step(decimation)
            handler.get_states()

    def theirs() -> None:
        for target in targets:
            loop.run(target, decimation)

    times = []
    for turn in range(turns + 1):
        begin()
        times.append(_in_turns(ours, theirs, turn))
        away = np.abs(handler.get_states().robots[robot].joint_pos.numpy() - loop.joints()).max()
        if away > 1e-6:
            raise SimulatorError(f"The joints ended {away:.2g} apart: this is not the same physics.")
    handler.close()
    bare.close()
    seconds = np.array(times[1:]) / (control_steps * num_envs)
    return Measurement(
        name=f"control step of {TASK}, {num_envs} environments, one thread: handler / SAPIEN's own loop",
        ours_s=median(seconds[:, 0]),
        baseline_s=median(seconds[:, 1]),
        ratio=median(seconds[:, 0] / seconds[:, 1]),
        goal=f"goal ≤ {OVERHEAD_GOAL:.2f}",
    )


class _Loop:
    """What a script on SAPIEN alone would do with the scenes that a handler has built."""

    def __init__(self, handler: Any, robot: str) -> None:
        self._handler, self._robot = handler, robot

    def find(self) -> None:
        """Finds what it works with in the scenes as they are now."""
        self._found = []
        for world in self._handler._worlds:
            system = world._scene.physx_system
            links = system.articulation_link_components
            arm = next(link.articulation for link in links if link.name.startswith(f"{self._robot}/"))
            joints = [joint for joint in arm.get_active_joints() if joint.stiffness > 0.0]
            cube = system.rigid_dynamic_components[0]
            self._found.append((system, arm, joints, arm.links[-1].entity, cube))

    def run(self, target: np.ndarray, num_steps: int) -> None:
        """One control step of every scene."""
        for row, (system, arm, joints, hand, cube) in enumerate(self._found):
            for joint, value in zip(joints, target[row].tolist(), strict=True):
                joint.set_drive_target(value)
            for _ in range(num_steps):
                system.step()
            pose, end = cube.entity.pose, hand.pose
            self._last = (arm.get_qpos(), arm.get_qvel(), pose.p, pose.q, end.p, end.q)
            self._last += (cube.linear_velocity, cube.angular_velocity)

    def joints(self) -> np.ndarray:
        """Joint positions of every scene, (N, J)."""
        return np.stack([arm.get_qpos() for _, arm, *_ in self._found])


def measure_processes(*, num_envs: int = 8, turns: int = 7, control_steps: int = 10) -> Measurement:
    """Compares control steps of environments in two processes to those of the same in one process.

    Returns:
        Seconds per control step of all environments; the ratio is one process over two: the speed-up.
    """
    from envs.handlers.processes import ProcessHandler
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = dataclasses.replace(task.scenario, cameras=task.scenario.cameras[:1])
    states = task.initial_state([np.random.default_rng(index) for index in range(num_envs)])
    robot, decimation = scenario.robots[0].name, scenario.physics.decimation
    options = {"simulator": "sapien", "renderer": "warp", "num_threads": 1}
    two, one = (ProcessHandler(scenario, num_envs, num_processes=count, **options) for count in (2, 1))
    target = states.robots[robot].joint_pos

    def run(handler: ProcessHandler) -> Callable[[], None]:
        def steps() -> None:
            for step in range(control_steps):
                handler.step_towards({robot: target + 0.02 * np.sin(step)}, decimation)
                handler.get_states()

        return steps

    with two, one:
        times = []
        for handler in (two, one):
            handler.launch()
        for turn in range(turns + 1):
            for handler in (two, one):
                handler.set_states(states)
                handler.step(1)
            times.append(_in_turns(run(two), run(one), turn))
    seconds = np.array(times[1:]) / control_steps
    return Measurement(
        name=f"control step of {TASK}, {num_envs} environments: speed-up of two processes over one",
        ours_s=median(seconds[:, 0]),
        baseline_s=median(seconds[:, 1]),
        ratio=median(seconds[:, 1] / seconds[:, 0]),
        goal=f"goal ≥ {SPEEDUP_GOAL:.1f} on two free cores",
    )


def _in_turns(ours: Callable[[], object], theirs: Callable[[], object], turn: int) -> tuple[float, float]:
    seconds = [0.0, 0.0]
    for which in (turn % 2, 1 - turn % 2):
        started = time.perf_counter()
        (ours, theirs)[which]()
        seconds[which] = time.perf_counter() - started
    return seconds[0], seconds[1]


def main() -> int:
    """Logs both measurements; the exit code is 1 where the overhead misses its goal or SAPIEN is absent."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--num-envs", type=int, default=1, help="environments of the first measurement")
    parser.add_argument("--turns", type=int, default=11)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    try:
        overhead = measure_overhead(num_envs=arguments.num_envs, turns=arguments.turns)
        log.info("%s", overhead)
        log.info("%s", measure_processes(turns=arguments.turns))
    except RoboVerseError as error:
        log.error("%s", error)
        return 1
    return int(overhead.ratio > OVERHEAD_GOAL)


if __name__ == "__main__":
    sys.exit(main())
