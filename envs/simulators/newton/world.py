"""One environment in Newton, stepped by its MuJoCo solver on the CPU."""

from typing import override

import mujoco
import newton
import numpy as np

from envs.rotations import conjugate, rotate
from envs.simulators.newton.scene import FreeRoot, NewtonScene
from envs.simulators.newton.settings import NewtonSettings
from envs.simulators.newton.shapes import check_pairs, view
from envs.simulators.translated_handler import World

_XYZW = [1, 2, 3, 0]
_WXYZ = [3, 0, 1, 2]


class NewtonWorld(World):
    """A Newton model of its own, its two states and its solver.

    Args:
        model: The compiled MuJoCo model that the scene was built from.
        scene: The builder and the addresses.
        settings: Options of the solver.

    Raises:
        SimulatorError: if the solver's model has other pairs of shapes that touch.
    """

    def __init__(self, model: mujoco.MjModel, scene: NewtonScene, settings: NewtonSettings) -> None:
        self._scene, self._timestep_s = scene, float(model.opt.timestep)
        self._newton = scene.builder.finalize(device="cpu")
        self._solver = newton.solvers.SolverMuJoCo(
            self._newton,
            separate_worlds=False,
            kinematic_switchable_roots=False,
            use_mujoco_cpu=True,
            enable_multiccd=True,  # MuJoCo's default, without which a cylinder sinks into a box
            integrator=settings.integrator,
            cone=settings.cone,
            impratio=settings.impratio,
            iterations=settings.iterations,
            tolerance=settings.tolerance,
        )
        check_pairs(model, self._solver.mj_model)
        self._now, self._next = self._newton.state(), self._newton.state()
        self._control = self._newton.control()
        self._targets, self._forces = view(self._control.joint_target_q), view(self._control.joint_f)

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        scene = self._scene
        q, qd = view(self._now.joint_q), view(self._now.joint_qd)
        q[scene.q], qd[scene.qd] = qpos[scene.qpos], qvel[scene.dof]
        for root in scene.roots:
            if root.qpos >= 0:
                q[root.q : root.q + 7] = _pose(qpos[root.qpos : root.qpos + 7])
                qd[root.qd : root.qd + 6] = _to_newton(qpos, qvel, root)
        self.drive(ctrl)
        data = self._solver.mj_data
        data.time = 0.0
        for past in (data.qacc_warmstart, data.qacc, data.qfrc_applied, data.xfrc_applied):
            past[:] = 0.0

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        q, qd = view(self._now.joint_q), view(self._now.joint_qd)
        for root in self._scene.roots:
            if root.mocap >= 0:
                q[root.q : root.q + 7] = _pose(
                    np.concatenate([mocap_pos[root.mocap], mocap_quat[root.mocap]])
                )
                qd[root.qd : root.qd + 6] = 0.0

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        self._targets[self._scene.driven] = ctrl[self._scene.actuator]
        self._forces[self._scene.pushed] = ctrl[self._scene.pusher]

    @override
    def step(self, num_steps: int) -> None:
        for _ in range(num_steps):
            self._solver.step(self._now, self._next, self._control, None, self._timestep_s)
            self._now, self._next = self._next, self._now

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        scene = self._scene
        q, qd = view(self._now.joint_q), view(self._now.joint_qd)
        qpos[scene.qpos], qvel[scene.dof] = q[scene.q], qd[scene.qd]
        for root in scene.roots:
            if root.qpos >= 0:
                pose = q[root.q : root.q + 7]
                qpos[root.qpos : root.qpos + 3] = pose[:3]
                qpos[root.qpos + 3 : root.qpos + 7] = pose[3:][_WXYZ]
                qvel[root.dof : root.dof + 6] = _from_newton(
                    qpos[root.qpos + 3 : root.qpos + 7], qd[root.qd : root.qd + 6], root
                )

    @override
    def close(self) -> None:
        del self._solver, self._now, self._next, self._control


def _pose(pose: np.ndarray) -> np.ndarray:
    """Returns a pose with its quaternion as xyzw."""
    return np.concatenate([pose[:3], pose[3:][_XYZW]])


def _to_newton(qpos: np.ndarray, qvel: np.ndarray, root: FreeRoot) -> np.ndarray:
    """MuJoCo's velocity is that of the origin, and its rate of turning is in the body's frame."""
    rot = qpos[root.qpos + 3 : root.qpos + 7].astype(np.float64)
    speed = qvel[root.dof : root.dof + 6].astype(np.float64)
    turning = rotate(rot, speed[3:])
    return np.concatenate([speed[:3] + np.cross(turning, rotate(rot, root.centre)), turning])


def _from_newton(rot: np.ndarray, speed: np.ndarray, root: FreeRoot) -> np.ndarray:
    rot, speed = rot.astype(np.float64), speed.astype(np.float64)
    turning = speed[3:]
    linear = speed[:3] - np.cross(turning, rotate(rot, root.centre))
    return np.concatenate([linear, rotate(conjugate(rot), turning)])
