"""robosuite teleoperation: HDF5 with flat MuJoCo states and actions, and the XML of the model.

The layout is that of ``robosuite/scripts/collect_human_demonstrations.py`` (MIT), 1.0 and later:
``data/demo_<i>`` with ``states`` (R, 1 + nq + nv), time first, and ``actions`` (R, A), the last of which
closes the gripper when positive. The attribute ``model_file`` holds the XML, or (1.0) the name of its file.
"""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, override

import mujoco
import numpy as np

from envs.core.errors import DatasetError
from envs.scenario import RobotCfg
from envs.state import EntityState
from envs.tasks.base import Task
from envs.tasks.robosuite.pick_place import BIN_1
from roboverse_learn.data.importers.demonstration import (
    Demonstration,
    DemonstrationFile,
    Placement,
    Scene,
    array,
    assemble,
    check_scene,
    place_base,
    servo_targets,
    velocities,
)
from roboverse_learn.data.importers.hdf5 import READ_ERRORS, open_hdf5
from roboverse_learn.data.importers.retarget import Poses, Retargeter, robot_of_scene, set_fingers
from roboverse_learn.data.sources.importer import FileSource

_NUTS = {"SquareNut0": "square_nut", "RoundNut0": "round_nut"}
_GOODS = {"Milk0": "milk", "Bread0": "bread", "Cereal0": "cereal", "Can0": "can"}
_SINGLE = ("PickPlaceMilk", "PickPlaceBread", "PickPlaceCereal", "PickPlaceCan")

SCENES = {
    "NutAssembly": Scene("NutAssembly", _NUTS, also=("NutAssemblySquare", "NutAssemblyRound")),
    "NutAssemblySquare": Scene("NutAssemblySquare", _NUTS),
    "NutAssemblyRound": Scene("NutAssemblyRound", _NUTS),
    "PickPlace": Scene("PickPlace", _GOODS, also=_SINGLE),
    **{name: Scene(name, _GOODS) for name in _SINGLE},
    "Lift": Scene(
        "PickCube",
        {"cube": "cube"},
        {"variant": "lift"},
        "robosuite's Lift samples a cube of 40 to 44 mm a side; ours has 40 mm",
        also=("Lift",),
    ),
    "Stack": Scene(
        "StackCube",
        {"cubeA": "cube_a", "cubeB": "cube_b"},
        {},
        "robosuite's lower cube has 50 mm a side; ours has 40 mm",
        also=("Stack",),
    ),
}

PANDA = "Panda"
GRIP_SITES = ("gripper0_grip_site", "gripper0_right_grip_site")
"""The point between the fingertips, by the names of robosuite 1.0 and 1.5."""

BASES = ("robot0_link0", "robot0_base")
SAME_BASE_M = 2e-3
"""Bases nearer than this are the same: robosuite moved its own by 1 mm between 1.0 and 1.5."""

_MOVING_TAGS = ("body", "joint", "freejoint", "inertial", "geom", "site")
"""Elements of a model's worldbody that are needed; no others of a foreign file are compiled."""


class RobosuiteFile(DemonstrationFile):
    """See the module."""

    format: ClassVar = "robosuite"
    suffixes: ClassVar[tuple[str, ...]] = (".hdf5",)

    @override
    def __init__(self, path: Path, task: Task) -> None:
        self.path = path
        self._file = open_hdf5(path)
        try:
            group = self._file["data"]
            self.names = tuple(sorted(group, key=_number))
            attributes = {key: str(value) for key, value in group.attrs.items()}
        except READ_ERRORS as error:
            raise DatasetError(f"'{path}' holds no demonstrations of robosuite ({error}).") from error
        environment, self._source = _described(path, attributes)
        self._scene = check_scene(path, environment, SCENES, task)
        scenario = task.scenario
        self._robot, self._hz = scenario.robots[0], scenario.physics.control_hz
        self._scene_robot = robot_of_scene(task)
        self._objects = {item.name for item in scenario.objects}
        self._retargeter: Retargeter | None = None

    @override
    def read(self, name: str) -> Demonstration:
        try:
            return self._read(name)
        except (*READ_ERRORS, ValueError, ElementTree.ParseError) as error:
            if isinstance(error, DatasetError):
                raise
            raise DatasetError(f"Its record is incomplete or damaged: {error}.") from error

    def _read(self, name: str) -> Demonstration:
        group = self._file["data"][name]
        model = _compile(_model_xml(self.path, str(group.attrs["model_file"])))
        states = array(group["states"][:], (None, 1 + model.nq + model.nv), "states")
        actions = array(group["actions"][:], (None, None), "actions")
        if len(states) < 2 or not len(states) - 1 <= len(actions) <= len(states):
            raise DatasetError(f"It has {len(states)} states and {len(actions)} actions.")
        self._check_rate(states[:, 0])
        motion = _Motion.of(model, states)
        height = motion.table_m
        placement = place_base(motion.base.pos[0], motion.base.rot[0], self._scene_robot, height)
        joint_pos, facts = self._joint_pos(motion, placement)
        targets = servo_targets(self._robot, joint_pos, self._hz)
        set_fingers(self._robot, targets, (actions[: len(targets), -1] <= 0).astype(np.float64))
        objects = {
            ours: motion.free_body(theirs, placement)
            for theirs, ours in self._scene.objects.items()
            if ours in self._objects
        }
        speed = velocities(joint_pos, self._hz)
        return Demonstration(
            name=name,
            states=assemble(self._robot, joint_pos, targets, objects, joint_vel=speed),
            targets=targets,
            facts=facts | ({"differs": self._scene.note} if self._scene.note else {}),
        )

    def _check_rate(self, times: np.ndarray) -> None:
        recorded_hz = 1.0 / float(np.median(np.diff(times)))
        if abs(recorded_hz - self._hz) > 0.01 * self._hz:
            raise DatasetError(f"It was recorded at {recorded_hz:.1f} Hz; the task runs at {self._hz:g} Hz.")

    def _joint_pos(self, motion: "_Motion", placement: Placement) -> tuple[np.ndarray, dict[str, Any]]:
        """Returns joint positions (R, J) of our robot: the recorded ones, or those that follow the hand."""
        facts = {"robot": self._source, "targets": "from states"}
        miss = np.abs(placement.pos(motion.base.pos[0]) - np.asarray(self._robot.pos)).max()
        if self._source == PANDA and self._robot.name == "franka" and miss < SAME_BASE_M:
            return motion.panda(self._robot), facts
        if self._retargeter is None:
            self._retargeter = Retargeter(self._robot)
        hand = motion.hand
        done = self._retargeter.follow(Poses(placement.pos(hand.pos), placement.rot(hand.rot)))
        shares = motion.opening()
        set_fingers(self._robot, done.joint_pos, shares)
        return done.joint_pos, facts | {
            "targets": "retargeted",
            "max_error_m": round(done.max_error_m, 6),
        }

    @override
    def close(self) -> None:
        self._file.close()


class RobosuiteSource(FileSource):
    """``source=robosuite``."""

    file_type: ClassVar = RobosuiteFile


class _Motion(NamedTuple):
    """Poses of the recorded model, in its own world, at R moments."""

    model: mujoco.MjModel
    qpos: np.ndarray
    qvel: np.ndarray
    base: Poses
    hand: Poses
    table_m: float

    @classmethod
    def of(cls, model: mujoco.MjModel, states: np.ndarray) -> "_Motion":
        """Plays the recorded joint positions."""
        data = mujoco.MjData(model)
        qpos, qvel = states[:, 1 : 1 + model.nq], states[:, 1 + model.nq :]
        site = _first(data.site, GRIP_SITES)
        base = _first(data.body, BASES)
        pos, rot = np.empty((len(qpos), 3)), np.empty((len(qpos), 4))
        for row, values in enumerate(qpos):
            data.qpos[:] = values
            mujoco.mj_kinematics(model, data)
            pos[row] = site.xpos
            mujoco.mju_mat2Quat(rot[row], site.xmat)
        still = Poses(base.xpos[None].copy(), base.xquat[None].copy())
        return cls(model, qpos, qvel, still, Poses(pos, rot), _table_m(model, data))

    def panda(self, robot: RobotCfg) -> np.ndarray:
        """Returns the joints of a Panda in our order: its second finger counts the other way."""
        out = np.empty((len(self.qpos), len(robot.joints)))
        for index, joint in enumerate(robot.joints):
            name = f"robot0_{joint.name}"
            if joint.name in robot.gripper_joints:
                name = joint.name.replace("gripper/", "gripper0_")
            values = self.qpos[:, self._address(name)]
            out[:, index] = -values if joint.flip else values
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
        body = self.model.body(name)
        if body.jntnum[0] != 1 or body.dofnum[0] != 6:
            raise DatasetError(f"Its '{name}' does not move freely.")
        position, speed = self.model.jnt_qposadr[body.jntadr[0]], body.dofadr[0]
        return placement.entity(
            self.qpos[:, position : position + 3],
            self.qpos[:, position + 3 : position + 7],
            lin_vel=self.qvel[:, speed : speed + 3],
            ang_vel=self.qvel[:, speed + 3 : speed + 6],
        )

    def _address(self, name: str) -> int:
        names = (name, name.replace("gripper0_", "gripper0_right_"))
        return int(_first(self.model.joint, names).qposadr[0])


def _table_m(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Returns the height of what carries the objects: the table's top, or the lower side of the bins."""
    names = [model.site(index).name for index in range(model.nsite)]
    if "table_top" in names:
        return float(data.site("table_top").xpos[2])
    return float(data.body("bin1").xpos[2]) - BIN_1[2]


def _first(find: Any, names: tuple[str, ...]) -> Any:
    """Returns the first of these names that a model has."""
    for name in names:
        try:
            return find(name)
        except KeyError:
            continue
    raise KeyError(f"the model has no {' or '.join(names)}")


def _described(path: Path, attributes: dict[str, str]) -> tuple[str, str]:
    """Returns the environment and the robot that the attributes of a file name."""
    try:
        info = json.loads(attributes.get("env_info") or attributes.get("env_args") or "{}")
        kwargs = info.get("env_kwargs", info)
        environment = attributes.get("env") or str(info["env_name"])
        robots = kwargs.get("robots", PANDA)
    except (ValueError, KeyError, AttributeError) as error:
        raise DatasetError(
            f"'{path}' does not say which environment it is of ({error}): its group 'data' needs the "
            "attribute 'env' or 'env_args', as robosuite writes them."
        ) from error
    names = [robots] if isinstance(robots, str) else list(robots)
    if len(names) != 1:
        raise DatasetError(f"'{path}' moves {len(names)} robots; one can be imported.")
    return environment, str(names[0])


def _number(name: str) -> tuple[int, str]:
    digits = "".join(character for character in name if character.isdigit())
    return int(digits or 0), name


def _model_xml(path: Path, given: str) -> str:
    """Returns the model's XML: the attribute itself, or the file that it names."""
    if given.lstrip().startswith("<"):
        return given
    name = Path(given).name
    beside = [path.parent / "models" / name, path.parent / name]
    beside += [
        p for p in sorted(path.parent.glob(f"*_{name}")) if p.name.removesuffix(f"_{name}") in path.stem
    ]
    for file in beside:
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise DatasetError(f"Its model '{name}' is neither in '{path.parent / 'models'}' nor beside the file.")


def _compile(xml: str) -> mujoco.MjModel:
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
