"""What a script on a simulator alone would do: set targets, step, read what it needs. Nothing of ours.

A loop works with a scene that a handler has built, so that both sides have the same bodies and gains, and
reads once per control step what such a script reads: joints, the pose of the hand, and the cube's pose and
velocity, in the simulator's own conventions.
"""

from abc import ABC, abstractmethod
from typing import Any, override

import mujoco
import numpy as np

from envs.state import State


class Loop(ABC):
    """One scene of a simulator, without the handler.

    Args:
        handler: What built the scene; it is launched, has one environment, and is not asked for steps.
        robot: Name of the robot that gets targets.
    """

    def __init__(self, handler: Any, robot: str) -> None:
        self._handler, self._robot = handler, robot
        layout = next(item for item in handler.layout.robots if item.name == robot)
        self._qpos, self._ctrl = layout.qpos, layout.ctrl

    def begin(self, states: State) -> None:
        """Puts the scene into ``states`` and makes one physics step."""
        self._handler.set_states(states)
        self._handler.step(1)
        self.find()

    @abstractmethod
    def find(self) -> None:
        """Finds what it works with in the scene as it is now."""

    @abstractmethod
    def run(self, target: np.ndarray, num_steps: int) -> None:
        """Makes one control step towards ``target`` (J,)."""

    @abstractmethod
    def joints(self) -> np.ndarray:
        """Returns the positions of the driven joints, in the simulator's order."""


class MujocoLoop(Loop):
    """``mj_step`` on an ``MjData`` of its own."""

    @override
    def begin(self, states: State) -> None:
        handler, model = self._handler, self._handler.model
        handler.set_states(states)
        (start,) = handler.snapshot()
        self._model, self._data = model, mujoco.MjData(model)
        self._data.qpos[:] = start.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = start.mocap_pos, start.mocap_quat
        self._data.ctrl[self._ctrl] = handler.get_joint_targets(self._robot)[0]
        mujoco.mj_step(model, self._data)
        self.find()

    @override
    def find(self) -> None:
        site = next(item.ee_site for item in self._handler.layout.robots if item.name == self._robot)
        self._hand = self._data.site(site)

    @override
    def run(self, target: np.ndarray, num_steps: int) -> None:
        data = self._data
        data.ctrl[self._ctrl] = target
        mujoco.mj_step(self._model, data, num_steps)
        self._last = (data.qpos.copy(), data.qvel.copy(), self._hand.xpos.copy(), self._hand.xmat.copy())

    @override
    def joints(self) -> np.ndarray:
        return self._data.qpos[self._qpos]


class SapienLoop(Loop):
    """Drive targets, ``PhysxSystem.step``, and the poses of entities."""

    @override
    def find(self) -> None:
        self._system = self._handler.worlds[0]._scene.physx_system
        links = self._system.articulation_link_components
        self._arm = next(link.articulation for link in links if link.name.startswith(f"{self._robot}/"))
        self._joints = [joint for joint in self._arm.get_active_joints() if joint.stiffness > 0.0]
        self._hand = self._arm.links[-1].entity
        self._cube = self._system.rigid_dynamic_components[0]

    @override
    def run(self, target: np.ndarray, num_steps: int) -> None:
        for joint, value in zip(self._joints, target.tolist(), strict=True):
            joint.set_drive_target(value)
        for _ in range(num_steps):
            self._system.step()
        arm, pose, end, cube = self._arm, self._cube.entity.pose, self._hand.pose, self._cube
        self._last = (arm.get_qpos(), arm.get_qvel(), pose.p, pose.q, end.p, end.q)
        self._last += (cube.linear_velocity, cube.angular_velocity)

    @override
    def joints(self) -> np.ndarray:
        return self._arm.get_qpos()


class PybulletLoop(Loop):
    """``stepSimulation`` with the motors' velocities and forces set before each step.

    What the motors are told, :mod:`envs.simulators.pybullet.drives`, is part of the physics that is compared:
    Bullet's own position control has other gains.
    """

    @override
    def find(self) -> None:
        import pybullet

        world = self._handler.worlds[0]
        driven = [part for part in world._parts if part.drives is not None and len(part.drives._driven)]
        (arm,) = driven
        self._bullet, self._client, self._drives = pybullet, world.client, arm.drives
        self._arm, self._hand = arm.unique, max(arm.links.values())
        self._cube = next(part.unique for part in world._parts if part.tree.free)
        self._row = np.zeros(self._handler.model.nu)

    @override
    def run(self, target: np.ndarray, num_steps: int) -> None:
        bullet, drives, client = self._bullet, self._drives, {"physicsClientId": self._client}
        self._row[self._ctrl] = target
        drives.aim(self._row)
        drives.linearize()
        for _ in range(num_steps):
            drives.push()
            bullet.stepSimulation(**client)
        self._last = (
            bullet.getJointStates(self._arm, drives.indices, **client),
            bullet.getBasePositionAndOrientation(self._cube, **client),
            bullet.getBaseVelocity(self._cube, **client),
            bullet.getLinkState(self._arm, self._hand, computeForwardKinematics=1, **client),
        )

    @override
    def joints(self) -> np.ndarray:
        return self._drives.read()[0]


class NewtonLoop(Loop):
    """``SolverMuJoCo.step`` from one state to the other, and arrays of the state."""

    @override
    def find(self) -> None:
        world = self._handler.worlds[0]
        self._solver, self._control = world._solver, world._control
        self._now, self._next, self._step_s = world._now, world._next, world._timestep_s
        self._targets = self._control.joint_target_q.numpy()
        scene = world._scene
        order = {
            int(actuator): int(place) for actuator, place in zip(scene.actuator, scene.driven, strict=True)
        }
        self._driven = np.array([order[int(actuator)] for actuator in self._ctrl])
        self._joints = scene.q[np.isin(scene.qpos, self._qpos)]

    @override
    def run(self, target: np.ndarray, num_steps: int) -> None:
        self._targets[self._driven] = target
        for _ in range(num_steps):
            self._solver.step(self._now, self._next, self._control, None, self._step_s)
            self._now, self._next = self._next, self._now
        now = self._now
        self._last = tuple(array.numpy().copy() for array in (now.joint_q, now.joint_qd, now.body_q))

    @override
    def joints(self) -> np.ndarray:
        return self._now.joint_q.numpy()[self._joints]


class GenesisLoop(Loop):
    """``Scene.step`` with the drives' targets set before each, and what the solver says of joints and links.

    What a drive at its limit is told, :mod:`envs.simulators.genesis.batch`, is part of the physics.
    """

    @override
    def find(self) -> None:
        self._batch = batch = self._handler.batch
        self._scene, self._solver = batch._scene, batch._solver
        self._row, self._drives = np.zeros(self._handler.model.nu), batch.drives_of(np.array([0]))

    @override
    def run(self, target: np.ndarray, num_steps: int) -> None:
        solver, scene, batch = self._solver, self._scene, self._batch
        self._row[self._ctrl] = target
        targets = self._row[batch._actuators][:, None]
        for _ in range(num_steps):
            batch.aim(self._drives, targets)
            scene.step(update_visualizer=False, refresh_visualizer=False)
        self._last = (solver.get_qpos(), solver.get_dofs_velocity(), solver.get_links_pos())

    @override
    def joints(self) -> np.ndarray:
        return self._solver.get_qpos().numpy()[0][self._batch._driven_q]


LOOPS: dict[str, type[Loop]] = {
    "mujoco": MujocoLoop,
    "sapien": SapienLoop,
    "pybullet": PybulletLoop,
    "newton": NewtonLoop,
    "genesis": GenesisLoop,
}
"""Simulators to their own loops; ``roboverse benchmark mujoco_warp`` measures the one that is missing."""
