"""robosuite teleoperation: HDF5 with flat MuJoCo states and actions, and the XML of the model.

The layout is that of ``robosuite/scripts/collect_human_demonstrations.py`` (MIT), 1.0 and later:
``data/demo_<i>`` with ``states`` (R, 1 + nq + nv), time first, and ``actions`` (R, A), the last of which
closes the gripper when positive. The attribute ``model_file`` holds the XML, or (1.0) the name of its file.
"""

import json
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, override

import numpy as np

from envs.core.errors import DatasetError
from envs.robots.franka import FRANKA
from envs.scenario import RobotCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.robosuite.two_arm_transport import BIN_HEIGHT_M, WALL_M
from envs.tasks.robosuite.wipe import MARKERS, SHOWN_Z_M
from roboverse_learn.data.importers.demonstration import (
    Demonstration,
    DemonstrationFile,
    Placement,
    SceneMapping,
    array,
    assemble,
    check_scene,
    place_base,
    servo_targets,
    velocities,
)
from roboverse_learn.data.importers.hdf5 import open_hdf5
from roboverse_learn.data.importers.remembered import remember
from roboverse_learn.data.importers.retarget import Poses, Retargeter, robot_of_scene, set_fingers
from roboverse_learn.data.importers.robosuite_motion import Fixture, Motion, compile_motion
from roboverse_learn.data.sources.importer import FileSource

_NUTS = {"SquareNut0": "square_nut", "RoundNut0": "round_nut"}
_GOODS = {"Milk0": "milk", "Bread0": "bread", "Cereal0": "cereal", "Can0": "can"}
_LOAD = {"payload": "payload", "trash": "trash", "transport_start_bin_lid": "lid"}
_SINGLE = ("PickPlaceMilk", "PickPlaceBread", "PickPlaceCereal", "PickPlaceCan")

SCENES = {
    "NutAssembly": SceneMapping("NutAssembly", _NUTS, also=("NutAssemblySquare", "NutAssemblyRound")),
    "NutAssemblySquare": SceneMapping("NutAssemblySquare", _NUTS),
    "NutAssemblyRound": SceneMapping("NutAssemblyRound", _NUTS),
    "PickPlace": SceneMapping("PickPlace", _GOODS, also=_SINGLE),
    **{name: SceneMapping(name, _GOODS) for name in _SINGLE},
    "ToolHang": SceneMapping("ToolHang", {"stand": "stand", "frame": "frame", "tool": "tool"}),
    "Door": SceneMapping("Door", {}),
    "Wipe": SceneMapping("Wipe", {}),
    "TwoArmLift": SceneMapping("TwoArmLift", {"pot": "pot"}),
    "TwoArmHandover": SceneMapping("TwoArmHandover", {"hammer": "hammer"}),
    "TwoArmPegInHole": SceneMapping("TwoArmPegInHole", {}),
    "TwoArmTransport": SceneMapping("TwoArmTransport", _LOAD),
    "Lift": SceneMapping(
        "PickCube",
        {"cube": "cube"},
        {"variant": "lift"},
        "robosuite's Lift samples a cube of 40 to 44 mm a side; ours has 40 mm",
        also=("Lift",),
    ),
    "Stack": SceneMapping(
        "StackCube",
        {"cubeA": "cube_a", "cubeB": "cube_b"},
        {},
        "robosuite's lower cube has 50 mm a side; ours has 40 mm",
        also=("Stack",),
    ),
}

_FLOOR_M = (WALL_M - BIN_HEIGHT_M) / 2
FIXTURES: dict[str, dict[str, Fixture]] = {
    "Door": {"door": Fixture("Door", joints=("Door_hinge", "Door_latch_joint"))},
    "Wipe": {
        name: Fixture(f"contact{index}_main", (0.0, 0.0, SHOWN_Z_M)) for index, name in enumerate(MARKERS)
    },
    "TwoArmTransport": {
        f"{name}_{part}": Fixture(f"transport_{name}_bin", (0.0, 0.0, up_m))
        for name in ("start", "target", "trash")
        for part, up_m in (("floor", _FLOOR_M), ("walls", 0.0))
    },
}
"""What is bolted down in an episode of ours, but elsewhere in each."""


class Alike(NamedTuple):
    """Bodies of one kind, whose number is an option of robosuite's.

    Attributes:
        what: What they are.
        pattern: Regular expression of their names.
    """

    what: str
    pattern: str


ALIKE = {"Wipe": Alike("markers of dirt", r"contact\d+_main")}
"""Environments whose fixtures are all of one kind; a recording has as many as the task."""

PANDA = "Panda"
SAME_BASE_M = 2e-3
"""Bases nearer than this are the same: robosuite moved its own by 1 mm between 1.0 and 1.5."""


class RobosuiteFile(DemonstrationFile):
    """See the module."""

    format: ClassVar = "robosuite"
    suffixes: ClassVar[tuple[str, ...]] = (".hdf5",)

    @override
    def _open(self, task: Task) -> None:
        path = self.path
        self._file = open_hdf5(path)
        try:
            group = self._file["data"]
            self.names = tuple(sorted(group, key=_number))
            attributes = {key: str(value) for key, value in group.attrs.items()}
        except (KeyError, OSError, RuntimeError, TypeError) as error:  # absent, of another kind, or damaged
            raise DatasetError(f"'{path}' holds no demonstrations of robosuite ({error}).") from error
        environment, self._sources = _described(path, attributes)
        self._task, self._scene = task, check_scene(path, environment, SCENES, task)
        self._fixtures, self._alike = FIXTURES.get(environment, {}), ALIKE.get(environment)
        scenario = task.scenario
        self._robots, self._hz = scenario.robots, scenario.physics.control_hz
        if len(self._sources) != len(self._robots):
            raise DatasetError(
                f"'{path}' moves {len(self._sources)} robots; in {task.name} there are {len(self._robots)}."
            )
        self._scene_robot = robot_of_scene(task) if len(self._robots) == 1 else self._robots[0]
        self._objects = {item.name: item.joint_names for item in scenario.objects}
        self._retargeter: Retargeter | None = None

    @override
    def _read(self, name: str) -> Demonstration:
        group = self._file["data"][name]
        model = compile_motion(_model_xml(self.path, str(group.attrs["model_file"])))
        states = array(group["states"][:], (None, 1 + model.nq + model.nv), "states")
        actions = array(group["actions"][:], (None, None), "actions")
        if len(states) < 2 or not len(states) - 1 <= len(actions) <= len(states):
            raise DatasetError(f"It has {len(states)} states and {len(actions)} actions.")
        self._check_rate(states[:, 0])
        motion = Motion.of(model, states, len(self._robots))
        base = motion.bases[0]
        placement = place_base(base.pos[0], base.rot[0], self._scene_robot, motion.table_m)
        objects = self._placed(motion, placement)
        entities, targets, facts = dict[str, EntityState](), list[np.ndarray](), dict[str, Any]()
        for index, robot in enumerate(self._robots):
            joint_pos, facts = self._joint_pos(motion, placement, index)
            ahead = servo_targets(robot, joint_pos, self._hz)
            if robot.gripper_joints:  # each robot's part of an action ends with its gripper
                last = (index + 1) * actions.shape[1] // len(self._robots) - 1
                set_fingers(robot, ahead, (actions[: len(ahead), last] <= 0).astype(np.float64))
            speed = velocities(joint_pos, self._hz)
            one = assemble(robot, joint_pos, ahead, objects, joint_vel=speed)
            entities |= one.robots
            targets.append(ahead)
        moments = State(entities, objects)
        remember(self._task, moments)
        return Demonstration(
            name=name,
            states=moments,
            targets=np.concatenate(targets, axis=1),
            facts=facts | ({"differs": self._scene.note} if self._scene.note else {}),
        )

    def _placed(self, motion: Motion, placement: Placement) -> dict[str, EntityState]:
        """Returns the moments of the scene's objects, free ones and those that are bolted down."""
        objects = {
            ours: motion.free_body(theirs, placement)
            for theirs, ours in self._scene.objects.items()
            if ours in self._objects
        }
        if self._alike is not None:
            found = motion.count_bodies(self._alike.pattern)
            if found != len(self._fixtures):
                raise DatasetError(
                    f"It has {found} {self._alike.what} as robosuite 1.5 names them; "
                    f"{self._scene.task} has {len(self._fixtures)}."
                )
        for ours, fixture in self._fixtures.items():
            own = fixture.joints[: len(self._objects[ours])]
            for joint in fixture.joints:
                if motion.has_joint(joint) != (joint in own):
                    has = "has" if joint not in own else "lacks"
                    raise DatasetError(f"Its {ours} {has} the joint '{joint}': the task's options differ.")
            objects[ours] = motion.fixture(fixture._replace(joints=own), placement)
        return objects

    def _check_rate(self, times: np.ndarray) -> None:
        recorded_hz = 1.0 / float(np.median(np.diff(times)))
        if abs(recorded_hz - self._hz) > 0.01 * self._hz:
            raise DatasetError(f"It was recorded at {recorded_hz:.1f} Hz; the task runs at {self._hz:g} Hz.")

    def _joint_pos(
        self, motion: Motion, placement: Placement, index: int
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Returns joint positions (R, J) of one of our robots: those recorded, or what follows the hand."""
        robot, source, base = self._robots[index], self._sources[index], motion.bases[index]
        facts = {"robot": source, "targets": "from states"}
        miss = np.abs(placement.pos(base.pos[0]) - np.asarray(robot.pos)).max()
        if source == PANDA and _is_panda(robot) and miss < SAME_BASE_M:
            return motion.panda(robot, index), facts
        if len(self._robots) > 1:
            raise DatasetError(
                f"Its robot {index} is a {source}, {1000 * miss:.0f} mm from where '{robot.name}' stands. "
                "Of several robots, Pandas that stand where ours do can be imported."
            )
        if self._retargeter is None:
            self._retargeter = Retargeter(robot)
        hand = motion.hands[index]
        done = self._retargeter.follow(Poses(placement.pos(hand.pos), placement.rot(hand.rot)))
        shares = motion.opening()
        set_fingers(robot, done.joint_pos, shares)
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


def _described(path: Path, attributes: dict[str, str]) -> tuple[str, tuple[str, ...]]:
    """Returns the environment and the robots that the attributes of a file name."""
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
    return environment, tuple(str(name) for name in names)


def _is_panda(robot: RobotCfg) -> bool:
    """Returns whether a robot of ours has a Panda's arm, and its hand or none."""
    return robot.joint_names == FRANKA.joint_names[: len(robot.joints)]


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
