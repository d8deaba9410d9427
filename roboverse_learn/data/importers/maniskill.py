"""ManiSkill 3 trajectories: an HDF5 file with ``env_states``, and the JSON file beside it.

The layout is that of ``mani_skill/trajectory`` (Apache-2.0): group ``traj_<episode_id>`` with ``actions``
(T, A), ``success`` (T,), and ``env_states`` of T + 1 moments: actors as pos, quaternion wxyz, linear and
angular velocity in the world (13 numbers); articulations likewise, then joint positions and velocities.
Of two robots the actions are one after the other, as ManiSkill's ``FlattenActionSpaceWrapper`` writes them.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np

from envs.core.errors import DatasetError
from envs.rotations import conjugate, multiply, rotate
from envs.scenario import IDENTITY, RobotCfg
from envs.state import EntityState, State
from envs.tasks import TASKS
from envs.tasks.base import Task
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
    within_range,
)
from roboverse_learn.data.importers.hdf5 import open_hdf5
from roboverse_learn.data.importers.maniskill_sizes import check_sizes, peg_sizes
from roboverse_learn.data.sources.importer import FileSource

_DISC, _END = "goal_region", "goal_ee"
_DISCS = (_DISC, _END)
"""ManiSkill's discs on the table: their axis is x, and they are turned to lie; ours lie as they are."""

_BOX = "box_with_hole"
_CUBES = {"cubeA": "cube_a", "cubeB": "cube_b"}
SCENES = {
    "PickCube-v1": SceneMapping("PickCube", {"cube": "cube", "goal_site": "goal"}),
    "StackCube-v1": SceneMapping("StackCube", _CUBES),
    "PushCube-v1": SceneMapping("PushCube", {"cube": "cube", _DISC: "goal"}),
    "PullCube-v1": SceneMapping("PullCube", {"cube": "cube", _DISC: "goal"}),
    "PokeCube-v1": SceneMapping("PokeCube", {"cube": "cube", "peg": "peg", _DISC: "goal"}),
    "LiftPegUpright-v1": SceneMapping("LiftPegUpright", {"peg": "peg"}),
    "RollBall-v1": SceneMapping("RollBall", {"ball": "ball", _DISC: "goal"}),
    "PlaceSphere-v1": SceneMapping("PlaceSphere", {"sphere": "sphere", "bin": "bin"}),
    "PullCubeTool-v1": SceneMapping("PullCubeTool", {"cube": "cube", "l_shape_tool": "tool"}),
    "StackPyramid-v1": SceneMapping("StackPyramid", {**_CUBES, "cubeC": "cube_c"}),
    "PlugCharger-v1": SceneMapping("PlugCharger", {"charger": "charger", "receptacle": "receptacle"}),
    "PegInsertionSide-v1": SceneMapping("PegInsertionSide", {"peg": "peg", _BOX: "box"}),
    "PushT-v1": SceneMapping("PushT", {"Tee": "tee", "goal_Tee": "goal", _END: "end"}),
    "TwoRobotPickCube-v1": SceneMapping("TwoRobotPickCube", {"cube": "cube", "goal_site": "goal"}),
    "TwoRobotStackCube-v1": SceneMapping("TwoRobotStackCube", {**_CUBES, _DISC: "goal"}),
}
"""Their robots are Pandas, the kinematics of ours, with joints in the same order."""

GRIPPER_RANGE_M = (-0.01, 0.04)
"""Finger positions of the gripper actions -1 and 1 (``agents/robots/panda/panda.py``)."""

DEFAULT_CONTROL_HZ = 20.0
"""ManiSkill's ``SimConfig.control_freq``."""

ROOT = 13
"""Numbers of a body's state; a robot's joint positions and velocities come after those of its base."""

_LAID = (0.5**0.5, 0.0, -(0.5**0.5), 0.0)
"""Orientation of our disc in ManiSkill's, wxyz."""


class ManiSkillFile(DemonstrationFile):
    """See the module."""

    format: ClassVar = "maniskill"
    suffixes: ClassVar[tuple[str, ...]] = (".h5",)

    @override
    def _open(self, task: Task) -> None:
        path = self.path
        info = _read_json(path)
        env = info["env_info"]
        self._scene = check_scene(path, str(env["env_id"]), SCENES, task)
        scenario = task.scenario
        self._task, self._robots, self._hz = task, scenario.robots, scenario.physics.control_hz
        self._objects = {item.name for item in scenario.objects}
        own = [robot.name for robot in TASKS.get(self._scene.task)().robots]
        if (given := [robot.name for robot in self._robots]) != own:
            raise DatasetError(
                f"'{path}' moves a Panda; the task's robot is '{given[0]}'. Import it without "
                f"robot=, then: roboverse collect source=retarget from=<its dataset> robot={given[0]}"
            )
        kwargs = env.get("env_kwargs") or {}
        recorded_hz = float((kwargs.get("sim_config") or {}).get("control_freq", DEFAULT_CONTROL_HZ))
        if abs(recorded_hz - self._hz) > 1e-6:
            raise DatasetError(
                f"'{path}' was recorded at {recorded_hz:g} Hz; the task runs at {self._hz:g} Hz. Record it "
                "again with sim_config.control_freq of the task."
            )
        self._episodes = {f"traj_{episode['episode_id']}": episode for episode in info["episodes"]}
        self._mode = str(kwargs.get("control_mode", ""))
        self._file = open_hdf5(path)
        self.names = tuple(self._episodes)

    @override
    def _read(self, name: str) -> Demonstration:
        group, episode = self._file[name], self._episodes[name]
        if "env_states" not in group:
            raise DatasetError("It has no env_states. Record with RecordEpisode(record_env_state=True).")
        states = group["env_states"]
        pandas = sorted(key for key in states["articulations"] if key.startswith("panda"))
        if len(pandas) != len(self._robots):
            raise DatasetError(
                f"Its robots are '{', '.join(states['articulations'])}'; {self._task.name} has "
                f"{len(self._robots)}, and only ManiSkill's panda can be imported."
            )
        read = [
            array(
                states["articulations"][key][:],
                (None, ROOT + 2 * len(robot.joints)),
                f"The state of '{key}'",
            )
            for key, robot in zip(pandas, self._robots, strict=True)
        ]
        actions = array(group["actions"][:], (len(read[0]) - 1, None), "actions")
        if actions.shape[1] % len(read):
            raise DatasetError(f"Its actions have {actions.shape[1]} numbers, for {len(read)} robots.")
        mode = str(episode.get("control_mode", self._mode))
        if self._scene.task == "PegInsertionSide":
            heights = (float(states["actors"]["peg"][0, 2]), float(states["actors"][_BOX][0, 2]))
            check_sizes(self._task, peg_sizes(*heights, episode.get("episode_seed")))
        scene = {theirs: ours for theirs, ours in self._scene.objects.items() if ours in self._objects}
        actors = {
            theirs: array(states["actors"][theirs][:], (None, ROOT), f"The state of '{theirs}'")
            for theirs in scene
        }
        objects = placed_objects(scene, actors, self._robots[0], read[0])
        success = group["success"][:] if "success" in group else None
        entities, targets = dict[str, EntityState](), list[np.ndarray]()
        parts = np.split(actions, len(read), axis=1)
        for robot, values, own in zip(self._robots, read, parts, strict=True):
            joints = len(robot.joints)
            qpos, qvel = values[:, ROOT : ROOT + joints], values[:, ROOT + joints :]
            targets.append(self._targets(robot, qpos, own, mode))
            entities |= assemble(robot, qpos, targets[-1], objects, joint_vel=qvel).robots
        return Demonstration(
            name=name,
            states=State(entities, objects),
            targets=np.concatenate(targets, axis=1),
            succeeded=None if success is None else bool(success[-1]),
            facts={"control_mode": mode, "targets": "recorded" if mode == "pd_joint_pos" else "from states"},
        )

    def _targets(self, robot: RobotCfg, qpos: np.ndarray, actions: np.ndarray, mode: str) -> np.ndarray:
        """Returns joint targets; those of other control modes than joint positions come from the states."""
        low, high = GRIPPER_RANGE_M
        fingers = [low + (actions[:, -1:] + 1.0) / 2.0 * (high - low)] * len(robot.gripper_joints)
        arm = len(robot.arm)
        if mode == "pd_joint_pos" and actions.shape[1] == arm + bool(fingers):
            targets = actions[:, :arm]
        else:
            targets = servo_targets(robot, qpos, self._hz)[:, :arm]
        return within_range(robot, np.concatenate([targets, *fingers], axis=1))

    @override
    def close(self) -> None:
        self._file.close()


class ManiSkillSource(FileSource):
    """``source=maniskill``."""

    file_type: ClassVar = ManiSkillFile


def placed_objects(
    scene: Mapping[str, str], actors: Mapping[str, np.ndarray], robot: RobotCfg, first: np.ndarray
) -> dict[str, EntityState]:
    """Returns the moments of objects in our scene, by our names.

    Args:
        scene: Their names to ours.
        actors: Their states, each (R, 13).
        robot: Our first robot.
        first: Moments of theirs.
    """
    placement = place_base(first[0, :3], first[0, 3:7], robot)
    return {
        ours: _object(actors[theirs], placement, _LAID if theirs in _DISCS else IDENTITY)
        for theirs, ours in scene.items()
    }


def _object(values: np.ndarray, placement: Placement, frame: Sequence[float]) -> EntityState:
    """Returns one actor's moments; SAPIEN's angular velocities are the world's, ours the body's.

    Args:
        values: The actor's states.
        placement: Of their scene in ours.
        frame: Orientation of our object in the actor, wxyz.
    """
    rot = values[:, 3:7] / np.linalg.norm(values[:, 3:7], axis=1, keepdims=True)
    rot = multiply(rot, np.asarray(frame))
    turning = rotate(conjugate(rot), values[:, 10:13])
    return placement.entity(values[:, :3], rot, lin_vel=values[:, 7:10], ang_vel=turning)


def _read_json(path: Path) -> dict[str, Any]:
    """Reads the description beside an HDF5 file."""
    beside = path.with_suffix(".json")
    if not beside.is_file():
        raise DatasetError(
            f"'{path}' needs '{beside.name}' beside it, which says what was recorded. Copy both files."
        )
    try:
        info = json.loads(beside.read_text(encoding="utf-8"))
        if not isinstance(info["env_info"]["env_id"], str):
            raise TypeError("env_id is no text")
        for episode in info["episodes"]:
            int(episode["episode_id"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DatasetError(f"'{beside}' describes no ManiSkill trajectories ({error!r}).") from error
    return info
