"""Handlers against scripts on the simulator alone: ``roboverse speed simulators``.

Ours takes targets, steps, and returns the states of all robots and objects. The script works with a scene
that a handler has built, so that both have the same bodies and gains: it sets targets, steps, and reads
joints, the pose of the hand, and the pose and velocity of the cube once per control step, in the simulator's
own conventions. Times are processor time, which a busy machine hardly changes.
"""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, override

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.state import State
from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

TASK = "PickCube"
GOAL = Goal(1.15, at_least=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatorsSettings(Settings):
    """Compares handlers to scripts on the simulator alone.

    Attributes:
        parts: mujoco, sapien, pybullet.
        turns: How often each side is timed.
        out: JSON file for the measurements.
    """

    turns: int = 11


class Loop(ABC):
    """A script on one scene of a simulator.

    Args:
        handler: What built the scene: launched, with one environment.
        robot: Name of the robot that gets targets.
    """

    def __init__(self, handler: Any, robot: str) -> None:
        self.handler, self.robot = handler, robot
        self.layout = next(item for item in handler.layout.robots if item.name == robot)

    def begin(self, states: State) -> None:
        """Sets the scene to ``states`` and makes one physics step."""
        self.handler.set_states(states)
        self.handler.step(1)
        self.find()

    @abstractmethod
    def find(self) -> None:
        """Finds what it works with in the scene as it is now."""

    @abstractmethod
    def run(self, target: np.ndarray, num_steps: int) -> tuple:
        """Makes one control step towards ``target`` (J,); returns what such a script reads."""

    @abstractmethod
    def joints(self) -> np.ndarray:
        """Returns the positions of the driven joints, in the simulator's order."""


class MujocoLoop(Loop):
    """``mj_step`` on an ``MjData`` of its own."""

    @override
    def begin(self, states: State) -> None:
        handler = self.handler
        handler.set_states(states)
        (start,) = handler.snapshot()
        self._model, self._data = handler.model, mujoco.MjData(handler.model)
        self._data.qpos[:] = start.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = start.mocap_pos, start.mocap_quat
        self._data.ctrl[self.layout.ctrl] = handler.get_joint_targets(self.robot)[0]
        mujoco.mj_step(self._model, self._data)
        self.find()

    @override
    def find(self) -> None:
        self._hand = self._data.site(self.layout.ee_site)

    @override
    def run(self, target: np.ndarray, num_steps: int) -> tuple:
        data = self._data
        data.ctrl[self.layout.ctrl] = target
        mujoco.mj_step(self._model, data, num_steps)
        return data.qpos.copy(), data.qvel.copy(), self._hand.xpos.copy(), self._hand.xmat.copy()

    @override
    def joints(self) -> np.ndarray:
        return self._data.qpos[self.layout.qpos]


class SapienLoop(Loop):
    """Drive targets, ``PhysxSystem.step``, and the poses of entities."""

    @override
    def find(self) -> None:
        self._system = self.handler.worlds[0].native.physx_system
        links = self._system.articulation_link_components
        self._arm = next(link.articulation for link in links if link.name.startswith(f"{self.robot}/"))
        self._joints = [joint for joint in self._arm.get_active_joints() if joint.stiffness > 0.0]
        self._hand = self._arm.links[-1].entity
        self._cube = self._system.rigid_dynamic_components[0]

    @override
    def run(self, target: np.ndarray, num_steps: int) -> tuple:
        for joint, value in zip(self._joints, target.tolist(), strict=True):
            joint.set_drive_target(value)
        for _ in range(num_steps):
            self._system.step()
        arm, pose, end, cube = self._arm, self._cube.entity.pose, self._hand.pose, self._cube
        poses = (pose.p, pose.q, end.p, end.q)
        return arm.get_qpos(), arm.get_qvel(), *poses, cube.linear_velocity, cube.angular_velocity

    @override
    def joints(self) -> np.ndarray:
        return self._arm.get_qpos()


class PybulletLoop(Loop):
    """``stepSimulation`` with the motors' velocities and forces set before each step.

    How the motors are driven, :mod:`envs.simulators.pybullet.drives`, is part of the physics that is
    compared: Bullet's own position control has other gains.
    """

    @override
    def find(self) -> None:
        import pybullet

        world = self.handler.worlds[0]
        self._bullet, self._client = pybullet, {"physicsClientId": world.client}
        bodies = range(pybullet.getNumBodies(**self._client))
        size = {body: pybullet.getNumJoints(body, **self._client) for body in bodies}
        self._arm = max(bodies, key=size.__getitem__)
        self._hand = size[self._arm] - 1
        self._cube = next(
            body
            for body in bodies
            if not size[body] and pybullet.getDynamicsInfo(body, -1, **self._client)[0] > 0.0
        )
        self._drives = max(world.drives, key=lambda drives: len(drives.dofs))
        self._row = np.zeros(self.handler.model.nu)

    @override
    def run(self, target: np.ndarray, num_steps: int) -> tuple:
        bullet, drives, client = self._bullet, self._drives, self._client
        self._row[self.layout.ctrl] = target
        drives.aim(self._row)
        drives.linearize()
        for _ in range(num_steps):
            drives.push()
            bullet.stepSimulation(**client)
        return (
            bullet.getJointStates(self._arm, drives.indices, **client),
            bullet.getBasePositionAndOrientation(self._cube, **client),
            bullet.getBaseVelocity(self._cube, **client),
            bullet.getLinkState(self._arm, self._hand, computeForwardKinematics=1, **client),
        )

    @override
    def joints(self) -> np.ndarray:
        return self._drives.read()[0]


LOOPS: dict[str, type[Loop]] = {"mujoco": MujocoLoop, "sapien": SapienLoop, "pybullet": PybulletLoop}
"""Simulators to their scripts; ``roboverse speed mujoco_warp`` measures mujoco_warp."""


def parts(settings: SimulatorsSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    return {name: partial(measure_overhead, name, turns=settings.turns) for name in LOOPS}


def measure_overhead(simulator: str, *, turns: int = 11, control_steps: int = 20) -> Measurement:
    """Compares control steps of one environment to a script over the same scene.

    Args:
        simulator: One of :data:`LOOPS`.
        turns: How often each side is timed.
        control_steps: Control steps of one turn.

    Raises:
        MissingExtraError: if the simulator is not installed.
        SimulatorError: The two did not end in the same state.
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

        def begin() -> None:
            handler.set_states(states)
            handler.step(1)  # rebuilds what a set state invalidates, outside the timed part
            loop.begin(states)

        def ours() -> None:
            for target in targets:
                handler.set_joint_targets({robot: target})
                handler.step(decimation)
                handler.get_states()

        def script() -> None:
            for target in targets:
                loop.run(target[0], decimation)

        def check() -> None:
            joints = handler.get_states().robots[robot].joint_pos[0].numpy()
            gap = np.abs(np.sort(joints) - np.sort(loop.joints())).max()
            if not gap <= 1e-5:
                raise SimulatorError(f"The joints ended {gap:.2g} apart: this is not the same physics.")

        seconds = in_turns(ours, script, turns, clock=time.process_time, before=begin, after=check)
    name = f"{simulator}: control step of {TASK}, handler / script on the simulator alone"
    return measurement(name, seconds, GOAL, units=control_steps)


if __name__ == "__main__":
    sys.exit(program("simulators", SimulatorsSettings, parts))
