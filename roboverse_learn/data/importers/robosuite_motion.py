"""What a recorded model of robosuite does: poses of its robots and objects, from flat MuJoCo states."""

import re
import xml.etree.ElementTree as ElementTree
from typing import Any, NamedTuple

import mujoco
import numpy as np

from envs.core.errors import DatasetError
from envs.scenario import RobotCfg, Vec3
from envs.state import EntityState
from envs.tasks.robosuite.pick_place import BIN_1
from roboverse_learn.data.importers.demonstration import Placement
from roboverse_learn.data.importers.retarget import Poses

_TABLE_TOPS = ("table_top", "table0_top")
_MOVING_TAGS = ("body", "joint", "freejoint", "inertial", "geom", "site")
"""Elements of a model's worldbody that are needed; no others of a foreign file are compiled."""


class Fixture(NamedTuple):
    """Something of robosuite's that is bolted down in our scene.

    Attributes:
        body: Its body.
        offset_m: Place of our origin from its own, in the world.
        joints: Its joints, in our order.
    """

    body: str
    offset_m: Vec3 = (0.0, 0.0, 0.0)
    joints: tuple[str, ...] = ()


class Motion(NamedTuple):
    """Poses of the recorded model, in its own world, at R moments.

    Attributes:
        model: The model.
        qpos: Joint positions, (R, nq).
        qvel: Joint velocities, (R, nv).
        bases: Pose of each robot's base.
        hands: Poses of the point between the fingertips of each robot that has one.
        table_m: Height of what carries the objects.
    """

    model: mujoco.MjModel
    qpos: np.ndarray
    qvel: np.ndarray
    bases: tuple[Poses, ...]
    hands: tuple[Poses, ...]
    table_m: float

    @classmethod
    def of(cls, model: mujoco.MjModel, states: np.ndarray, num_robots: int) -> "Motion":
        """Plays the recorded joint positions."""
        data = mujoco.MjData(model)
        qpos, qvel = states[:, 1 : 1 + model.nq], states[:, 1 + model.nq :]
        sites = [_grip_site(data, index) for index in range(num_robots)]
        poses = [Poses(np.empty((len(qpos), 3)), np.empty((len(qpos), 4))) for _ in sites]
        for row, values in enumerate(qpos):
            data.qpos[:] = values
            mujoco.mj_kinematics(model, data)
            for site, (pos, rot) in zip(sites, poses, strict=True):
                pos[row] = site.xpos
                mujoco.mju_mat2Quat(rot[row], site.xmat)
        bases = [
            _first(data.body, (f"robot{index}_link0", f"robot{index}_base")) for index in range(num_robots)
        ]
        still = tuple(Poses(base.xpos[None].copy(), base.xquat[None].copy()) for base in bases)
        return cls(model, qpos, qvel, still, tuple(poses), _table_m(model, data))

    def panda(self, robot: RobotCfg, index: int) -> np.ndarray:
        """Returns the joints of a Panda in our order: its second finger counts the other way."""
        out = np.empty((len(self.qpos), len(robot.joints)))
        for column, joint in enumerate(robot.joints):
            name = f"robot{index}_{joint.name}"
            if joint.name in robot.gripper_joints:
                name = joint.name.replace("gripper/", f"gripper{index}_")
            names = (name, name.replace(f"gripper{index}_", f"gripper{index}_right_"))
            values = self.qpos[:, int(_first(self.model.joint, names).qposadr[0])]
            out[:, column] = -values if joint.flip else values
        return out

    def opening(self) -> np.ndarray:
        """Returns how far the gripper is open, 0 to 1, (R,), by the ranges of its joints."""
        names = [self.model.joint(index).name for index in range(self.model.njnt)]
        shares = []
        for name in (name for name in names if name.startswith("gripper0_")):
            joint = self.model.joint(name)
            shut, wide = sorted(joint.range, key=abs)
            shares.append((self.qpos[:, joint.qposadr[0]] - shut) / (wide - shut))
        if not shares:
            raise DatasetError("Its robot has no gripper.")
        return np.clip(np.mean(shares, axis=0), 0.0, 1.0)

    def free_body(self, name: str, placement: Placement) -> EntityState:
        """Returns one free body's moments."""
        body = self._body(name)
        if body.jntnum[0] != 1 or body.dofnum[0] != 6:
            raise DatasetError(f"Its '{name}' does not move freely.")
        position, speed = self.model.jnt_qposadr[body.jntadr[0]], body.dofadr[0]
        return placement.entity(
            self.qpos[:, position : position + 3],
            self.qpos[:, position + 3 : position + 7],
            lin_vel=self.qvel[:, speed : speed + 3],
            ang_vel=self.qvel[:, speed + 3 : speed + 6],
        )

    def fixture(self, fixture: Fixture, placement: Placement) -> EntityState:
        """Returns the moments of something that is bolted down in our scene, and of its joints."""
        body = self._body(fixture.body)
        if body.jntnum[0]:  # robosuite's bins could move
            still = self.free_body(fixture.body, Placement(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)))
            pos, rot = still.pos.numpy(), still.rot.numpy()
        else:
            data, count = mujoco.MjData(self.model), len(self.qpos)
            mujoco.mj_kinematics(self.model, data)
            pos, rot = (np.tile(values[body.id], (count, 1)) for values in (data.xpos, data.xquat))
        joints = [self.model.joint(name) for name in fixture.joints]
        return placement.entity(
            pos + fixture.offset_m,
            rot,
            joint_pos=self.qpos[:, [joint.qposadr[0] for joint in joints]],
            joint_vel=self.qvel[:, [joint.dofadr[0] for joint in joints]],
        )

    def has_joint(self, name: str) -> bool:
        """Returns whether the model has a joint of this name."""
        return any(self.model.joint(index).name == name for index in range(self.model.njnt))

    def count_bodies(self, pattern: str) -> int:
        """Returns how many bodies have a name that is all of a regular expression."""
        names = [self.model.body(index).name for index in range(self.model.nbody)]
        return sum(re.fullmatch(pattern, name) is not None for name in names)

    def _body(self, name: str) -> Any:
        """Returns a body by its name in robosuite 1.0, ``Can0``, or as later ones call it, ``Can_main``."""
        stem = name.rstrip("0123456789")
        return _first(self.model.body, (name, f"{stem}_main", f"{stem}_root"))


def _grip_site(data: mujoco.MjData, index: int) -> Any:
    """Returns a robot's grip site, by its name in robosuite 1.0 or 1.5."""
    gripper = (f"gripper{index}_grip_site", f"gripper{index}_right_grip_site")
    return _first(data.site, gripper)


def _table_m(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Returns the height of what carries the objects: a table's top, bins' lower side, or the ground."""
    names = [model.site(index).name for index in range(model.nsite)]
    tops = [name for name in names if name in _TABLE_TOPS]
    if tops:
        return float(data.site(tops[0]).xpos[2])
    bodies = [model.body(index).name for index in range(model.nbody)]
    if "bin1" in bodies:
        return float(data.body("bin1").xpos[2]) - BIN_1[2]
    if any(name.startswith("table") for name in bodies):
        raise KeyError("the model's table has no site of its top")
    return 0.0


def _first(find: Any, names: tuple[str, ...]) -> Any:
    """Returns the first of these names that a model has."""
    for name in names:
        try:
            return find(name)
        except KeyError:
            continue
    raise KeyError(f"the model has no {' or '.join(names)}")


def compile_motion(xml: str) -> mujoco.MjModel:
    """Compiles what moves of a recorded model: its meshes and images lie on another machine."""
    root = ElementTree.fromstring(xml)
    for child in list(root):
        if child.tag not in ("compiler", "worldbody"):
            root.remove(child)
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    for key in ("meshdir", "texturedir", "assetdir"):
        compiler.attrib.pop(key, None)
    compiler.attrib |= {"boundmass": "1e-4", "boundinertia": "1e-8"}  # of bodies whose meshes are dropped
    for parent in list(root.iter()):
        for child in list(parent):
            mesh = child.tag == "geom" and (child.get("mesh") or child.get("type") == "mesh")
            if mesh or (parent is not root and child.tag not in _MOVING_TAGS):
                parent.remove(child)
            else:
                for key in ("material", "class", "childclass"):
                    child.attrib.pop(key, None)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
