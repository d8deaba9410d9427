"""States of MuJoCo whose fields are made when they are read.

A task reads few fields of a state, and one environment steps in 0.5 ms: making a tensor of every field
would take 10 % of it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, override

import mujoco
import numpy as np
import torch

from envs.mjcf.layout import EntityLayout, as_slice
from envs.state import EntityState

Reader = Callable[["StateArrays"], np.ndarray | None]


@dataclass(slots=True)  # a frozen one takes twice as long to make
class StateArrays:
    """MuJoCo's arrays of n environments at one time, in copies.

    Attributes:
        qpos: Joint positions, (n, nq).
        qvel: Joint velocities, (n, nv).
        ctrl: Actuator targets, (n, nu).
        mocap_pos: Positions of the bodies that are put in place, (n, nmocap, 3).
        mocap_quat: Their orientations, (n, nmocap, 4).
        site_xpos: Positions of sites, (n, nsite, 3).
        site_xmat: Their orientations, (n, nsite, 9).
        sensordata: Sensor readings, (n, nsensordata).
    """

    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray
    site_xpos: np.ndarray
    site_xmat: np.ndarray
    sensordata: np.ndarray

    @classmethod
    def of(cls, arrays: Sequence[np.ndarray], rows: np.ndarray | None) -> "StateArrays":
        """Copies rows, or all, of live arrays, which are in the order of the fields."""
        return cls(*[array.copy() if rows is None else array[rows] for array in arrays])


class ArrayEntity(EntityState):
    """An entity in numpy arrays; a field is made when it is first read.

    Args:
        arrays: The arrays.
        readers: Field to how it is read from them.
    """

    __slots__ = ("_arrays", "_readers")

    def __init__(self, arrays: StateArrays, readers: Mapping[str, Reader]) -> None:  # no field is set yet
        self._arrays, self._readers = arrays, readers

    def __getattr__(self, name: str) -> Any:
        value = self._made(name)  # set once, as it stays: another thread may read the field meanwhile
        setattr(self, name, value)
        return value

    def _made(self, name: str) -> Any:
        reader = None if name == "_readers" else self._readers.get(name)
        if reader is None:
            raise AttributeError(name)
        return reader(self._arrays)

    @override
    def arrays(self) -> EntityState:
        return self

    def __reduce__(self):
        return EntityState, tuple(getattr(self, name) for name in EntityState.__slots__)


class ReadEntity(ArrayEntity):
    """The same in tensors."""

    __slots__ = ()

    @override
    def _made(self, name: str) -> Any:
        value = super()._made(name)
        return None if value is None else torch.from_numpy(value)

    @override
    def arrays(self) -> EntityState:
        return ArrayEntity(self._arrays, self._readers)


def readers_of(entity: EntityLayout, num_joints: int) -> dict[str, Reader]:
    """Returns how each field of an entity is read.

    Args:
        entity: A robot, which has an end effector, or an object.
        num_joints: How many joints it has.
    """
    joints, speeds, targets = as_slice(entity.qpos), as_slice(entity.qvel), as_slice(entity.ctrl)
    readers: dict[str, Reader] = {**_root(entity), "touched": _touched(entity)}
    if num_joints:
        readers["joint_pos"] = lambda m: m.qpos[:, joints]
        readers["joint_vel"] = lambda m: m.qvel[:, speeds]
    else:
        readers["joint_pos"] = readers["joint_vel"] = _still(0)
    if entity.ee_site < 0:
        return {**readers, "joint_target": _none, "ee_pos": _none, "ee_rot": _none}
    site = entity.ee_site
    readers["joint_target"] = lambda m: m.ctrl[:, targets]
    readers["ee_pos"] = lambda m: m.site_xpos[:, site]
    readers["ee_rot"] = lambda m: _quaternions(m.site_xmat[:, site])
    return readers


def _root(entity: EntityLayout) -> dict[str, Reader]:
    if entity.root == "free":
        at, speed = entity.root_qpos, entity.root_qvel
        return {
            "pos": lambda m: m.qpos[:, at : at + 3],
            "rot": lambda m: m.qpos[:, at + 3 : at + 7],
            "lin_vel": lambda m: m.qvel[:, speed : speed + 3],
            "ang_vel": lambda m: m.qvel[:, speed + 3 : speed + 6],
        }
    readers: dict[str, Reader] = {"lin_vel": _still(3), "ang_vel": _still(3)}
    if entity.root == "mocap":
        index = entity.mocap
        readers["pos"] = lambda m: m.mocap_pos[:, index]
        readers["rot"] = lambda m: m.mocap_quat[:, index]
        return readers
    pos, rot = entity.pos, entity.rot
    readers["pos"] = lambda m: np.tile(pos, (len(m.qpos), 1))
    readers["rot"] = lambda m: np.tile(rot, (len(m.qpos), 1))
    return readers


def _touched(entity: EntityLayout) -> Reader:
    touches = as_slice(entity.touches)
    if not len(entity.touches):
        return _none
    return lambda m: (m.sensordata[:, touches] > 0.0).astype(np.float64)


def _still(size: int) -> Reader:
    return lambda m: np.zeros((len(m.qpos), size))


def _none(arrays: StateArrays) -> None:
    return None


def _quaternions(matrices: np.ndarray) -> np.ndarray:
    """Returns wxyz quaternions (n, 4) of rotation matrices (n, 9)."""
    out = np.empty((len(matrices), 4))
    for quat, matrix in zip(out, matrices, strict=True):
        mujoco.mju_mat2Quat(quat, matrix)
    return out
