"""Jointed bodies of PhysX: their states and targets, from and to the model's arrays."""

import math
from typing import override

import numpy as np
from sapien import Pose, physx

from envs.mjcf.link_tree import TreeSpec
from envs.simulators.sapien.bodies import Part
from envs.simulators.sapien.servos import Servos
from envs.simulators.sapien.velocities import from_physx, to_physx

SOFT_SPEED = 0.05
"""Speed, rad/s (m/s), at which a driven joint has most of its dry friction."""


class Articulation(Part):
    """Links and joints; the root moves freely, is put in place, or never moves."""

    def __init__(self, articulation: physx.PhysxArticulation, tree: TreeSpec) -> None:
        self._articulation, self._tree = articulation, tree
        specs = {link.joint.name: link.joint for link in tree.links if link.joint is not None}
        joints = articulation.get_active_joints()
        order = [specs[joint.name] for joint in joints]
        self._qpos = np.array([spec.qpos for spec in order], np.intp)
        self._dofs = np.array([spec.dof for spec in order], np.intp)
        drives = [
            (joint.set_drive_target, spec.actuator)
            for joint, spec in zip(joints, order, strict=True)
            if spec.actuator >= 0 and not spec.takes_force
        ]
        self._setters = [set_target for set_target, _ in drives]
        self._last = [math.nan] * len(drives)
        self._ctrl = np.array([actuator for _, actuator in drives], np.intp)
        self._pushed = np.array([spec.takes_force for spec in order], bool)
        self._pusher = np.array([spec.actuator for spec in order if spec.takes_force], np.intp)
        self._force = np.zeros(len(order))
        rubs = np.array([spec.friction > 0.0 for spec in order])
        driven = np.array([spec.actuator >= 0 for spec in order], bool)
        self._stiffness = np.where(rubs & ~driven, [spec.stiffness for spec in order], 0.0)
        self._damping = np.where(rubs & ~driven, [spec.damping for spec in order], 0.0)
        self._friction = np.where(rubs & driven, [spec.friction for spec in order], 0.0)
        self._rest = np.array([spec.rest for spec in order])
        self._servos = Servos(order) if tree.root == "free" else None
        passive = (self._stiffness, self._damping, self._friction)
        self.has_own_force = bool(self._servos) or any(np.any(a) for a in (*passive, self._pushed))
        inertia = tree.links[0].inertia
        self._centre = None if inertia is None else inertia.frame[0]
        self._pos, self._rot = slice(tree.qpos, tree.qpos + 3), slice(tree.qpos + 3, tree.qpos + 7)
        self._lin, self._ang = slice(tree.dof, tree.dof + 3), slice(tree.dof + 3, tree.dof + 6)

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        articulation = self._articulation
        if self._tree.root == "free":
            articulation.set_root_pose(Pose(qpos[self._pos], qpos[self._rot]))
            lin, ang = to_physx(qpos[self._rot], qvel[self._lin], qvel[self._ang], self._centre)
            articulation.set_root_linear_velocity(lin)
            articulation.set_root_angular_velocity(ang)
        articulation.set_qpos(qpos[self._qpos])
        articulation.set_qvel(qvel[self._dofs])
        articulation.set_qf(np.zeros(len(self._dofs), np.float32))
        articulation.set_qacc(np.zeros(len(self._dofs), np.float32))

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        if self._tree.root == "mocap":
            pose = Pose(mocap_pos[self._tree.mocap], mocap_quat[self._tree.mocap])
            self._articulation.set_root_pose(pose)

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        targets = ctrl[self._ctrl].tolist()
        for set_target, target, last in zip(self._setters, targets, self._last, strict=True):
            if target != last:
                set_target(target)
        self._last = targets
        self._force[self._pushed] = ctrl[self._pusher]
        if self._servos:
            self._servos.aim(ctrl)

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        articulation = self._articulation
        qpos[self._qpos], qvel[self._dofs] = articulation.get_qpos(), articulation.get_qvel()
        if self._tree.root == "free":
            pose = articulation.get_root_pose()
            qpos[self._pos], qpos[self._rot] = pose.p, pose.q
            lin, ang = articulation.get_root_linear_velocity(), articulation.get_root_angular_velocity()
            qvel[self._lin], qvel[self._ang] = from_physx(pose.q, lin, ang, self._centre)

    @override
    def push(self) -> None:
        articulation = self._articulation
        qpos, qvel = articulation.get_qpos(), articulation.get_qvel()
        force = self._force - self._stiffness * (qpos - self._rest) - self._damping * qvel
        force -= self._friction * np.tanh(qvel / SOFT_SPEED)
        if self._servos:
            force += self._servos.missing(qpos, qvel)
        articulation.set_qf(force.astype(np.float32))
