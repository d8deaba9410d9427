"""RoboVerse v2 trajectories: pickle or JSON, plain or gzipped.

The layout is that of ``metasim/utils/demo_util`` (Apache-2.0): ``{robot: [episode, …]}``, an episode with
``init_state`` and ``states`` (or None) of ``{entity: {pos, rot, dof_pos: {joint: value}}}``, and
``actions`` of ``{dof_pos_target: {joint: value}}``. ``actions[t]`` leads to ``states[t]``. Lengths are m,
quaternions wxyz; there are no velocities.
"""

import gzip
import json
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np

from envs.core.errors import DatasetError
from envs.robots import ROBOTS
from envs.scenario import ObjectCfg
from envs.state import EntityState
from envs.tasks.base import Task
from roboverse_learn.data.importers.demonstration import (
    Demonstration,
    DemonstrationFile,
    Placement,
    angular_velocities,
    array,
    assemble,
    place_base,
    tensor,
    velocities,
    within_range,
)
from roboverse_learn.data.importers.restricted_unpickler import load_pickle
from roboverse_learn.data.importers.retarget import (
    ARMS,
    Poses,
    Retargeted,
    Retargeter,
    opening,
    own_path,
    robot_of_scene,
    set_fingers,
    tool_path,
)
from roboverse_learn.data.sources.importer import FileSource

MAX_BYTES = 1 << 30
"""Largest file after unpacking: fifty times RoboVerse's own; a bomb ends here."""

JUMP_RAD = 0.2
"""A joint that moves farther in one step at 20 Hz (4 rad/s, twice a Franka's limit) was put there."""

OBJECTS = {"StackCube": {"cube": "cube_a", "base": "cube_b"}}
"""By task of ours: names of objects in RoboVerse's files that we call otherwise."""

JOINTS = {
    "franka": (
        *((f"panda_joint{i}", f"joint{i}") for i in range(1, 8)),
        ("panda_finger_joint1", "gripper/finger_joint1"),
        ("panda_finger_joint2", "gripper/finger_joint2"),
    )
}
"""Robots of ours that the files have too: their joints' names, and ours."""

Frame = Mapping[str, Any]


class RoboVerseFile(DemonstrationFile):
    """See the module."""

    format: ClassVar = "roboverse"
    suffixes: ClassVar[tuple[str, ...]] = (".pkl.gz", ".pkl", ".json.gz", ".json")

    @override
    def _open(self, task: Task) -> None:
        path, self._task = self.path, task
        scenario = task.scenario
        self._scenario, self._robot = scenario, scenario.robots[0]
        self._hz = scenario.physics.control_hz
        content = _load(path)
        known = [name for name in content if name in ARMS or name in JOINTS]
        if len(content) != 1 or not known or not isinstance(content[known[0]], list):
            raise DatasetError(
                f"'{path}' must hold the episodes of one robot of {', '.join(sorted({*ARMS, *JOINTS}))}; it "
                f"holds {', '.join(map(str, content)) or 'nothing'}."
            )
        self._source = known[0]
        self._episodes = content[self._source]
        self.names = tuple(f"{self._source}_{index}" for index in range(len(self._episodes)))
        if self._source != self._robot.name and not self._robot.gripper_joints:
            raise DatasetError(
                f"'{path}' moves '{self._source}', and the task's robot '{self._robot.name}' has no gripper "
                "to follow it with."
            )
        self._scene_robot = robot_of_scene(task)
        self._retargeter: Retargeter | None = None
        self._check_task()

    def _check_task(self) -> None:
        """Refuses a file of another task, whose objects are not ours."""
        first = next((e["init_state"] for e in self._episodes if _has_start(e)), None)
        named = set() if first is None else set(first) - {self._source}
        renamed = {self._ours(name) for name in named}
        wanted = {item.name for item in self._scenario.objects if item.kind != "marker"}
        if first is not None and not wanted <= renamed:
            raise DatasetError(
                f"'{self.path}' is of another task than {self._task.name}: it moves "
                f"{', '.join(sorted(named))}; the task needs {', '.join(sorted(wanted))}."
            )

    def _ours(self, name: str) -> str:
        return OBJECTS.get(self._task.name, {}).get(name, name)

    @override
    def _read(self, name: str) -> Demonstration:
        episode: Mapping[str, Any] = self._episodes[self.names.index(name)]
        frames: list[Frame] = [episode["init_state"], *(episode.get("states") or ())]
        actions = [action["dof_pos_target"] for action in episode["actions"]]
        if len(frames) > 1:  # actions continue where the states end
            actions = actions[: len(frames) - 1]
            frames = frames[: len(actions) + 1]
        base = frames[0][self._source]
        placement = place_base(
            array(base["pos"], (3,), "The base"), array(base["rot"], (4,), "The base"), self._scene_robot
        )
        joints = [frame[self._source]["dof_pos"] for frame in frames]
        facts: dict[str, Any] = {"robot": self._source, "targets": "recorded"}
        if self._source == self._robot.name:
            qpos, targets = self._own(joints), self._own(actions)
        else:
            moments, led = self._retarget(joints), self._retarget(actions)
            qpos, targets = moments.joint_pos, led.joint_pos
            missed = max(moments.max_error_m, led.max_error_m)
            facts |= {"targets": "retargeted", "max_error_m": round(missed, 6)}
        first = int(len(qpos) > 1 and np.abs(qpos[1] - qpos[0]).max() > JUMP_RAD)
        objects = {
            self._ours(key): self._object(key, frames, placement, first)
            for key in frames[0]
            if key != self._source and self._ours(key) in {item.name for item in self._scenario.objects}
        }
        targets = within_range(self._robot, targets)
        speed = velocities(qpos, self._hz, first)
        return Demonstration(
            name=name,
            states=assemble(self._robot, qpos, targets, objects, joint_vel=speed),
            targets=targets,
            first_state=first,
            facts=facts,
        )

    def _own(self, rows: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Returns joint positions (R, J) of a robot that is ours, in its order."""
        names = {ours: theirs for theirs, ours in JOINTS[self._source]}
        order = [names[name] for name in ROBOTS.get(self._source).joint_names]
        return array(
            [[row[name] for name in order] for row in rows], (None, len(order)), "The robot's joints"
        )

    def _retarget(self, rows: Sequence[Mapping[str, float]]) -> Retargeted:
        """Returns joint positions (R, J) of our robot that follow another one's."""
        local, open_share = self._path(rows)
        # Their base stands where that of the task's own robot does, which the scene was made for.
        own = self._scene_robot
        ours = Placement(np.asarray(own.rot), np.asarray(own.pos))
        if self._retargeter is None:
            self._retargeter = Retargeter(self._robot)
        done = self._retargeter.follow(Poses(ours.pos(local.pos), ours.rot(local.rot)))
        set_fingers(self._robot, done.joint_pos, open_share)
        return done

    def _path(self, rows: Sequence[Mapping[str, float]]) -> tuple[Poses, np.ndarray]:
        """Returns the hand's path in the frame of their base, and how far the gripper is open, (R,)."""
        if self._source in JOINTS:
            return own_path(ROBOTS.get(self._source), self._own(rows))
        arm = ARMS[self._source]
        columns = {
            name: array([row[name] for row in rows], (None,), name) for name in (*arm.joints, *arm.fingers)
        }
        return tool_path(arm, columns), opening(arm, columns)

    def _object(self, key: str, frames: Sequence[Frame], placement: Placement, first: int) -> EntityState:
        cfg: ObjectCfg = self._scenario.object(self._ours(key))
        count = len(frames)
        pos = array([frame[key]["pos"] for frame in frames], (count, 3), f"Positions of '{key}'")
        rot = array([frame[key]["rot"] for frame in frames], (count, 4), f"Orientations of '{key}'")
        joint_pos = None
        if cfg.joint_names:
            names = [_joint(frames[0][key]["dof_pos"], name, cfg) for name in cfg.joint_names]
            rows = [[frame[key]["dof_pos"][name] for name in names] for frame in frames]
            joint_pos = array(rows, (count, len(names)), f"Joints of '{key}'")
        entity = placement.entity(pos, rot, joint_pos=joint_pos)
        if joint_pos is not None:
            entity.joint_vel = tensor(velocities(joint_pos, self._hz, first))
        entity.lin_vel = tensor(velocities(entity.pos.numpy(), self._hz, first))
        entity.ang_vel = tensor(angular_velocities(entity.rot.numpy(), self._hz))
        return entity


class RoboVerseSource(FileSource):
    """``source=roboverse``."""

    file_type: ClassVar = RoboVerseFile


def _has_start(episode: Any) -> bool:
    """Returns whether an episode, which may be damaged, says how it begins."""
    return isinstance(episode, dict) and isinstance(episode.get("init_state"), dict)


def _joint(given: Mapping[str, float], name: str, cfg: ObjectCfg) -> str:
    """Returns the recorded name of a joint: ours, or the only one there is."""
    if name not in given and len(given) == 1 and len(cfg.joint_names) == 1:
        return next(iter(given))
    return name


def _load(path: Path) -> dict[str, Any]:
    """Reads a file without running anything of it.

    Raises:
        DatasetError: It is absent, truncated, too large, or no trajectory file.
    """
    opened: Any = gzip.open if path.name.endswith(".gz") else open
    try:
        with opened(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"'{path}' cannot be read ({error}). Download it again.") from error
    if len(data) > MAX_BYTES:
        raise DatasetError(f"'{path}' unpacks to more than {MAX_BYTES >> 20} MiB. Divide it.")
    if ".json" in path.suffixes:
        try:
            content = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise DatasetError(f"'{path}' is not JSON ({error}). Download it again.") from error
    else:
        content = load_pickle(data, str(path))
    if not isinstance(content, dict):
        raise DatasetError(f"'{path}' holds a {type(content).__name__}; RoboVerse's files hold a dict.")
    return content
