"""Rigid bodies of PhysX: their states and targets, from and to the model's arrays."""

from typing import override

import numpy as np
import sapien
from sapien import Pose, physx

from envs.mjcf.link_tree import TreeSpec
from envs.simulators.sapien.velocities import from_physx, to_physx


class Part:
    """A body or an articulation and its addresses in the model's arrays; by itself it does nothing."""

    has_own_force = False

    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Takes its positions and velocities from the row."""

    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        """Takes its pose from the row, if it is one that is put in place."""

    def drive(self, ctrl: np.ndarray) -> None:
        """Takes its targets from the row."""

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes its positions and velocities into the row."""

    def push(self) -> None:
        """Applies, for the next step, what PhysX has no passive force for."""


class KinematicBody(Part):
    """A body that stays where it is put."""

    def __init__(self, entity: sapien.Entity, mocap: int) -> None:
        self._entity, self._mocap = entity, mocap

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None: ...

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self._entity.pose = Pose(mocap_pos[self._mocap], mocap_quat[self._mocap])

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None: ...


class FreeBody(Part):
    """A rigid body that moves freely."""

    def __init__(self, component: physx.PhysxRigidDynamicComponent, tree: TreeSpec) -> None:
        self._component, self._entity = component, component.entity
        self._qpos = slice(tree.qpos, tree.qpos + 7)
        self._pos, self._rot = slice(tree.qpos, tree.qpos + 3), slice(tree.qpos + 3, tree.qpos + 7)
        self._lin, self._ang = slice(tree.dof, tree.dof + 3), slice(tree.dof + 3, tree.dof + 6)
        inertia = tree.links[0].inertia
        centre = np.zeros(3) if inertia is None else inertia.frame[0]
        self._centre = centre if np.abs(centre).max() > 1e-9 else None

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        pose = Pose(qpos[self._pos], qpos[self._rot])
        lin, ang = to_physx(qpos[self._rot], qvel[self._lin], qvel[self._ang], self._centre)
        self._entity.pose = pose
        self._component.linear_velocity, self._component.angular_velocity = lin, ang

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        pose, component = self._entity.pose, self._component
        rot = pose.q
        qpos[self._pos], qpos[self._rot] = pose.p, rot
        lin, ang = component.linear_velocity, component.angular_velocity
        qvel[self._lin], qvel[self._ang] = from_physx(rot, lin, ang, self._centre)
