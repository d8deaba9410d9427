"""Addresses of each robot and object in MuJoCo's arrays."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.mjcf.drives import DriveLengths, holding
from envs.mjcf.model import touch_sensor
from envs.mjcf.robots import ROOT_JOINT
from envs.scenario import ObjectCfg, RobotCfg, ScenarioCfg

Root = Literal["free", "fixed", "mocap"]


@dataclass(frozen=True, slots=True)
class EntityLayout:
    """Addresses of one robot or object.

    Attributes:
        name: Its name.
        root: How its root moves: with a free joint, never, or wherever it is put.
        root_qpos: Address of the free joint in qpos (7 numbers), or -1.
        root_qvel: Address of the free joint in qvel (6 numbers), or -1.
        mocap: Index in mocap_pos and mocap_quat, or -1.
        pos: Root position at rest.
        rot: Root orientation at rest, wxyz.
        qpos: Addresses of its joints in qpos, (J,).
        qvel: Addresses of its joints in qvel, (J,).
        ctrl: Addresses of the actuators of its driven joints in ctrl, or empty.
        driven: Indices of its driven joints among its joints.
        lengths: What their actuators measure.
        holds: For each of them 1.0 if its target is a position, 0.0 if it is a torque.
        ee_site: Id of the end effector's site, or -1.
        touches: Addresses of its contact sensors in sensordata.
    """

    name: str
    root: Root
    root_qpos: int
    root_qvel: int
    mocap: int
    pos: np.ndarray
    rot: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    driven: np.ndarray
    lengths: DriveLengths | None
    holds: np.ndarray
    ee_site: int
    touches: np.ndarray

    def held(self, joint_pos: Tensor) -> Tensor:
        """Returns the targets (N, D) that hold a robot's joints (N, J) where they are; of torques, none."""
        assert self.lengths is not None, "an object has no actuators"
        return self.lengths(joint_pos) * torch.from_numpy(self.holds).to(joint_pos)


@dataclass(frozen=True, slots=True)
class Layout:
    """Addresses of every robot and object."""

    robots: tuple[EntityLayout, ...]
    objects: tuple[EntityLayout, ...]


def layout_of(model: mujoco.MjModel, scenario: ScenarioCfg) -> Layout:
    """Finds every robot and object of the scenario in its compiled model."""
    robots = []
    for robot in scenario.robots:
        joints = [model.joint(f"{robot.name}/{name}") for name in robot.joint_names]
        driven = [robot.joint_names[index] for index in robot.driven]
        free = None if robot.fixed_base else model.joint(f"{robot.name}/{ROOT_JOINT}")
        robots.append(
            EntityLayout(
                name=robot.name,
                root="fixed" if free is None else "free",
                root_qpos=-1 if free is None else int(free.qposadr[0]),
                root_qvel=-1 if free is None else int(free.dofadr[0]),
                mocap=-1,
                pos=np.array(robot.pos, np.float64),
                rot=np.array(robot.rot, np.float64),
                qpos=np.array([joint.qposadr[0] for joint in joints], np.intp),
                qvel=np.array([joint.dofadr[0] for joint in joints], np.intp),
                ctrl=np.array([model.actuator(f"{robot.name}/{name}").id for name in driven], np.intp),
                driven=np.array(robot.driven, np.intp),
                lengths=DriveLengths(robot),
                holds=holding(robot),
                ee_site=model.site(f"{robot.name}/{robot.ee_site}").id,
                touches=_touches(model, robot),
            )
        )
    objects = []
    for item in scenario.objects:
        free = item.kind == "free"
        joints = [model.joint(f"{item.name}/{name}") for name in item.joint_names]
        objects.append(
            EntityLayout(
                name=item.name,
                root="free" if free else "mocap",
                root_qpos=int(model.joint(item.name).qposadr[0]) if free else -1,
                root_qvel=int(model.joint(item.name).dofadr[0]) if free else -1,
                mocap=int(model.body(item.name).mocapid[0]),
                pos=np.array(item.pos, np.float64),
                rot=np.array(item.rot, np.float64),
                qpos=np.array([joint.qposadr[0] for joint in joints], np.intp),
                qvel=np.array([joint.dofadr[0] for joint in joints], np.intp),
                ctrl=np.zeros(0, np.intp),
                driven=np.zeros(0, np.intp),
                lengths=None,
                holds=np.zeros(0),
                ee_site=-1,
                touches=_touches(model, item),
            )
        )
    return Layout(tuple(robots), tuple(objects))


def _touches(model: mujoco.MjModel, item: RobotCfg | ObjectCfg) -> np.ndarray:
    sensors = [model.sensor(touch_sensor(item.name, other)) for other in item.feels]
    return np.array([sensor.adr[0] for sensor in sensors], np.intp)


def as_slice(addresses: np.ndarray) -> slice | np.ndarray:
    """Returns consecutive addresses as a slice, which indexes without a copy."""
    if len(addresses) and (np.diff(addresses) == 1).all():
        return slice(int(addresses[0]), int(addresses[-1]) + 1)
    return addresses


def block(rows: slice | np.ndarray, columns: slice | np.ndarray) -> tuple:
    """Returns the index of every row in every column, whichever of them are slices."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        return rows, columns
    return np.ix_(rows, columns)
