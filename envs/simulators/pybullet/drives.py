"""Joints under position gains, as constraints of Bullet's solver.

MuJoCo's actuator is a force ``kp (target - q) - kd q̇``, integrated implicitly; applied as a force, step by
step, such gains blow up. Bullet's joint motor is a constraint: reach a velocity, with a force of so much at
most. Both numbers are set before every step. The velocity is the one that the implicit integration of all
joints gives::

    (M + A + h D + h² P) v = (M + A) q̇ + h (P (target - q) - c)

with mass matrix M, armature A, gains P and all damping D, gravity and Coriolis forces c, and time step h. The
force is ``kp |target - q| + kd |q̇|``, within the actuator's limit: the most that the actuator could need
on the way, and exactly ``kp |target - q|`` at rest, in the grip or under a load. An undriven joint has
damping and dry friction alone.
"""

from typing import Any

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.simulators.pybullet.trees import Tree


class Drives:
    """The joints of one tree.

    Args:
        bullet: The module.
        client: Its client.
        unique: Bullet's number of the tree.
        model: The compiled scene.
        tree: The tree.
    """

    def __init__(self, bullet: Any, client: int, unique: int, model: mujoco.MjModel, tree: Tree) -> None:
        self._bullet, self._client, self._unique = bullet, client, unique
        names = {model.joint(j).name: j for j in range(model.njnt)}
        self.indices: list[int] = []
        joints: list[int] = []
        for index in range(bullet.getNumJoints(unique, physicsClientId=client)):
            info = bullet.getJointInfo(unique, index, physicsClientId=client)
            if info[2] != bullet.JOINT_FIXED:
                self.indices.append(index)
                joints.append(names[info[1].decode()])
        count = len(joints)
        self.qpos = np.array([model.jnt_qposadr[j] for j in joints], np.intp)
        self.dofs = np.array([model.jnt_dofadr[j] for j in joints], np.intp)
        actuators = {int(model.actuator_trnid[index, 0]): index for index in range(model.nu)}
        self._driven = np.array([index for index, j in enumerate(joints) if j in actuators], np.intp)
        self._ctrl = np.array([actuators[joints[index]] for index in self._driven], np.intp)
        self._kp, self._kd, self._limit = np.zeros(count), np.zeros(count), np.zeros(count)
        self._kp[self._driven] = model.actuator_gainprm[self._ctrl, 0]
        self._kd[self._driven] = -model.actuator_biasprm[self._ctrl, 2]
        forces = np.where(model.actuator_forcelimited, model.actuator_forcerange[:, 1], np.inf)
        self._limit[self._driven] = forces[self._ctrl]
        self._damping = model.dof_damping[self.dofs].copy()
        self._friction = model.dof_frictionloss[self.dofs].copy()
        self._armature = model.dof_armature[self.dofs].copy()
        self._stiffness = np.array([np.ravel(model.jnt_stiffness[j])[0] for j in joints])
        self._rest = model.qpos_spring[self.qpos].copy()
        self._sprung = bool(self._stiffness.any())
        self._passive = np.setdiff1d(np.arange(count), self._driven)
        self._still = not len(self._driven) and not self._sprung and not self._damping.any()
        """Whether what was set once, its dry friction, is all that holds it."""
        self._step_s = float(model.opt.timestep)
        self._free = tree.free
        self._floats = bool((model.body_gravcomp[model.body_rootid == tree.body] > 0).any())
        if self._floats and tree.free:
            raise SimulatorError(
                f"simulator=pybullet cannot take gravity off '{model.body(tree.body).name}', whose base "
                "moves freely. Set gravity_compensated=False, or take simulator=mujoco."
            )
        self._zeros = [0.0] * count
        self._target = np.zeros(count)
        bullet.setJointMotorControlArray(
            unique,
            self.indices,
            bullet.VELOCITY_CONTROL,
            forces=self._friction.tolist(),
            physicsClientId=client,
        )

    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Puts the joints where the row says."""
        for index, position, speed in zip(
            self.indices, qpos[self.qpos].tolist(), qvel[self.dofs].tolist(), strict=True
        ):
            self._bullet.resetJointState(self._unique, index, position, speed, physicsClientId=self._client)

    def aim(self, ctrl: np.ndarray) -> None:
        """Takes the targets from the row."""
        self._target[self._driven] = ctrl[self._ctrl]

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the joints' positions and velocities."""
        states = self._bullet.getJointStates(self._unique, self.indices, physicsClientId=self._client)
        return np.array([state[0] for state in states]), np.array([state[1] for state in states])

    def linearize(self) -> None:
        """Takes the mass matrix and the forces of motion at the present state, for the steps that follow."""
        if self._still or not len(self._driven):
            return
        position, velocity = self.read()
        step, (mass, bias) = self._step_s, self._dynamics(position, velocity)
        self._inertia = mass + np.diag(self._armature)
        self._passive_drag = self._inertia + np.diag(step * self._damping)
        self._implicit = np.linalg.inv(self._passive_drag + np.diag(step * self._kd + step**2 * self._kp))
        self._bias = step * bias

    def _dynamics(self, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bullet, count = self._bullet, len(position)
        flat = position.tolist()
        mass = np.array(bullet.calculateMassMatrix(self._unique, flat, physicsClientId=self._client))
        if self._free:  # as if the base were held: its motion is not the joints' to decide
            return mass[-count:, -count:], np.zeros(count)
        bias = bullet.calculateInverseDynamics(
            self._unique, flat, velocity.tolist(), self._zeros, physicsClientId=self._client
        )
        return mass, np.array(bias) - (self._weight(position) if self._floats else 0.0)

    def _weight(self, position: np.ndarray) -> np.ndarray:
        """Forces of the joints that hold the links against gravity."""
        return np.array(
            self._bullet.calculateInverseDynamics(
                self._unique, position.tolist(), self._zeros, self._zeros, physicsClientId=self._client
            )
        )

    def _reachable(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Returns the velocities after the next step, as implicit integration gives them without contact."""
        step, error = self._step_s, self._target - position
        momentum = self._inertia @ velocity - self._bias
        reached = self._implicit @ (momentum + step * self._kp * error)
        force = self._kp * (error - step * reached) - self._kd * reached
        full = np.abs(force) > self._limit
        if full.any():  # what gives all its force gives no more the nearer it is
            gains = np.where(full, 0.0, step * self._kd + step**2 * self._kp)
            pull = np.where(full, np.clip(force, -self._limit, self._limit), self._kp * error)
            reached = np.linalg.solve(self._passive_drag + np.diag(gains), momentum + step * pull)
        return reached

    def push(self) -> None:
        """Sets each joint's velocity and force for the next step."""
        if self._still:
            return
        bullet, (position, velocity) = self._bullet, self.read()
        wanted = np.zeros(len(position))
        error = np.abs(self._target - position)
        speed = np.abs(velocity)
        force = self._friction + self._damping * speed
        if len(self._driven):
            wanted = self._reachable(position, velocity)
            wanted[self._passive] = 0.0
            force += np.minimum(self._kp * error + self._kd * speed, self._limit)
        bullet.setJointMotorControlArray(
            self._unique,
            self.indices,
            bullet.VELOCITY_CONTROL,
            targetVelocities=wanted.tolist(),
            forces=force.tolist(),
            physicsClientId=self._client,
        )
        if self._sprung or self._floats:
            force = self._stiffness * (self._rest - position)
            if self._floats:
                force += self._weight(position)
            bullet.setJointMotorControlArray(
                self._unique,
                self.indices,
                bullet.TORQUE_CONTROL,
                forces=force.tolist(),
                physicsClientId=self._client,
            )
