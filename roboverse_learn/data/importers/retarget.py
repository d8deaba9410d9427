"""Another robot's motion for ours: forward kinematics there, inverse kinematics here.

What is kept is the path of the point between the fingertips and its orientation, and how far the gripper
is open.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import torch

from envs.core.assets import resolve
from envs.core.errors import DatasetError
from envs.kinematics.forward import KinematicChain
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.rotations import from_matrix, multiply
from envs.scenario import IDENTITY, Quat, RobotCfg, ScenarioCfg
from envs.tasks import TASKS
from envs.tasks.base import Task

POSITION_TOLERANCE_M, TURN_TOLERANCE_RAD = 5e-4, 5e-3
"""A pose is reached when it is missed by less than this."""

POSITION_LIMIT_M, TURN_LIMIT_RAD = 0.01, 0.1
"""A path is refused when a pose of it is missed by more than this."""

GIVE_UP_M = 0.05
"""From a posture that misses a pose by this much, no further pose is tried."""

START_TURNS_RAD = tuple(
    (-elbow, elbow, wrist)
    for wrist in (0.0, -math.pi / 2, math.pi / 2, -math.pi)
    for elbow in (0.0, 1.0, -1.0, 1.8, -1.8)
)
"""Turns of the first, third and last joint from rest: the elbow to either side of a hand that stays in
front, and the hand turned."""

FIRST_ITERATIONS, ITERATIONS = 300, 12
"""Most differential steps for the first pose, and for every next one."""

STEP_S = 0.1
POSTURE_COST = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceArm:
    """The kinematics of a robot whose motion is followed.

    Attributes:
        mjcf: Asset reference of the arm.
        joints: Names of its joints in the recordings, to those in the file, in any order.
        hand: Body that carries the gripper.
        tool_m: Where our end effector belongs, along z of ``hand``.
        tool_rot: How it is turned there, wxyz.
        fingers: Names of the gripper's joints in the recordings, to their closed and open positions, m.
    """

    mjcf: str
    joints: Mapping[str, str]
    hand: str
    tool_m: float
    tool_rot: Quat
    fingers: Mapping[str, tuple[float, float]]


ARMS = {
    # RoboVerse's Sawyer demonstrations are its Franka ones, retargeted. With this tool, forward kinematics
    # of both files give the same path to 0.1 mm in episodes that both have.
    # The fingers' positions are the closed and the open one in the file.
    "sawyer": SourceArm(
        mjcf="robosuite:models/assets/robots/sawyer/robot.xml",
        joints={f"right_j{i}": f"right_j{i}" for i in range(7)},
        hand="right_hand",
        tool_m=0.0939,
        tool_rot=(math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)),
        fingers={
            "right_gripper_l_finger_joint": (0.0026, 0.0206),
            "right_gripper_r_finger_joint": (-0.0026, -0.0206),
        },
    ),
}


class Poses(NamedTuple):
    """A path.

    Attributes:
        pos: m, (R, 3).
        rot: wxyz, (R, 4).
    """

    pos: np.ndarray
    rot: np.ndarray


class Retargeted(NamedTuple):
    """A path followed by our robot.

    Attributes:
        joint_pos: (R, J); the gripper's joints are left at rest.
        max_error_m: Farthest that a pose is missed by.
        max_error_rad: Likewise, its orientation.
    """

    joint_pos: np.ndarray
    max_error_m: float
    max_error_rad: float


@lru_cache(maxsize=4)
def _arm_model(mjcf: str) -> mujoco.MjModel:
    """Compiles an arm without what is only seen or touched."""
    spec = mujoco.MjSpec.from_file(str(resolve(mjcf)))
    unneeded = (spec.geoms, spec.meshes, spec.cameras, spec.lights, spec.sensors, spec.actuators)
    for item in [item for items in unneeded for item in items]:
        spec.delete(item)
    return spec.compile()


def tool_path(arm: SourceArm, joint_pos: Mapping[str, np.ndarray]) -> Poses:
    """Returns the path of the tool in the frame of the robot's base.

    Args:
        arm: The robot.
        joint_pos: Name in the recordings to positions (R,).

    Raises:
        DatasetError: A joint is absent.
    """
    missing = sorted(set(arm.joints) - set(joint_pos))
    if missing:
        raise DatasetError(f"Its robot lacks the joints {', '.join(missing)}.")
    model = _arm_model(arm.mjcf)
    data = mujoco.MjData(model)
    address = [model.joint(name).qposadr[0] for name in arm.joints.values()]
    rows = np.stack([joint_pos[name] for name in arm.joints], axis=1)
    hand = data.body(arm.hand)
    pos, rot = np.empty((len(rows), 3)), np.empty((len(rows), 4))
    for row, values in enumerate(rows):
        data.qpos[address] = values
        mujoco.mj_kinematics(model, data)
        pos[row] = hand.xpos + hand.xmat.reshape(3, 3)[:, 2] * arm.tool_m
        rot[row] = hand.xquat
    return Poses(pos, multiply(rot, np.array(arm.tool_rot)))


def opening(arm: SourceArm, joint_pos: Mapping[str, np.ndarray]) -> np.ndarray:
    """Returns how far the gripper is open, 0 to 1, (R,).

    Raises:
        DatasetError: A finger is absent.
    """
    missing = sorted(set(arm.fingers) - set(joint_pos))
    if missing:
        raise DatasetError(f"Its gripper lacks the joints {', '.join(missing)}.")
    shares = [(joint_pos[name] - shut) / (wide - shut) for name, (shut, wide) in arm.fingers.items()]
    return np.clip(np.mean(shares, axis=0), 0.0, 1.0)


def own_path(robot: RobotCfg, joint_pos: np.ndarray) -> tuple[Poses, np.ndarray]:
    """Returns the path of a robot of ours in the frame of its base, and how far its gripper is open.

    Args:
        robot: The robot.
        joint_pos: Its joints, (R, J).
    """
    chain = KinematicChain(replace(robot, pos=(0.0, 0.0, 0.0), rot=IDENTITY))
    poses = chain(torch.from_numpy(np.ascontiguousarray(joint_pos[:, chain.columns], np.float64)))
    shut, wide = np.array(robot.finger_limits).T
    shares = (joint_pos[:, list(robot.fingers)] - shut) / (wide - shut)
    return Poses(poses.pos.numpy(), from_matrix(poses.rot.numpy())), np.clip(shares.mean(axis=1), 0.0, 1.0)


def robot_of_scene(task: Task) -> RobotCfg:
    """Returns the robot for which the scene of a task was made: its own, where another one does it."""
    if task.name not in TASKS:
        return task.robot
    options = {item.name: getattr(task, item.name) for item in fields(task)}  # pyright: ignore[reportArgumentType]
    own = TASKS.get(task.name)(**options).robot
    return task.robot if own.name == task.robot.name else own


def set_fingers(robot: RobotCfg, joint_pos: np.ndarray, open_share: np.ndarray) -> None:
    """Writes the gripper's joints of our robot into joint positions (R, J): 0 shut, 1 open, (R,)."""
    for index, (shut, wide) in zip(robot.fingers, robot.finger_limits, strict=True):
        joint_pos[:, index] = shut + open_share * (wide - shut)


class Retargeter:
    """Follows paths with one robot of ours.

    Args:
        robot: The robot; its ``ee_site`` follows.
    """

    def __init__(self, robot: RobotCfg) -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        self._model = build_model(scenario)
        self._qpos = layout_of(self._model, scenario).robots[0].qpos
        self._rest = np.array(robot.default_qpos)
        self._range = np.array([joint.range for joint in robot.joints]).T
        arm = [index for index, name in enumerate(robot.joint_names) if name not in robot.gripper_joints]
        self._turned = self._qpos[[arm[0], arm[2], arm[-1]]]
        self._configuration = mink.Configuration(self._model)
        self._task = mink.FrameTask(
            frame_name=f"{robot.name}/{robot.ee_site}",
            frame_type="site",
            position_cost=1.0,
            orientation_cost=0.3,
        )
        self._posture = mink.PostureTask(self._model, cost=POSTURE_COST)
        self._limits = [mink.ConfigurationLimit(self._model)]

    def follow(self, path: Poses) -> Retargeted:
        """Returns the joint positions that bring the end effector to every pose of a path.

        An arm of seven joints can begin in many postures, and from some it meets a limit on the way; so
        further ones are tried until one leads to the end.

        Args:
            path: In our world. Orientations are those of the robot's ``ee_site``.

        Raises:
            DatasetError: The robot cannot reach a pose from any of the postures.
        """
        best: tuple[float, np.ndarray, np.ndarray] | None = None
        for turns in START_TURNS_RAD:
            joint_pos, errors = self._follow_from(turns, path)
            worst = float((errors / [POSITION_LIMIT_M, TURN_LIMIT_RAD]).max())
            if best is None or worst < best[0]:
                best = worst, joint_pos, errors
            if worst <= 1.0:
                return Retargeted(joint_pos, *errors.max(axis=0).tolist())
        assert best is not None
        errors = best[2]
        row = int(np.argmax((errors / [POSITION_LIMIT_M, TURN_LIMIT_RAD]).max(axis=1)))
        raise DatasetError(
            f"Our robot cannot follow its path: at moment {row} it misses the pose by "
            f"{1000 * errors[row, 0]:.0f} mm and {np.degrees(errors[row, 1]):.0f} degrees."
        )

    def _follow_from(self, turns: tuple[float, float, float], path: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Follows from one posture: returns joint positions (R, J), and errors (R, 2) in m and rad."""
        rest = np.zeros(self._model.nq)
        rest[self._qpos] = self._rest
        rest[self._turned] += turns
        rest[self._qpos] = np.clip(rest[self._qpos], *self._range)
        self._posture.set_target(rest)
        self._configuration.update(rest)
        joint_pos = np.empty((len(path.pos), len(self._qpos)))
        errors = np.full((len(path.pos), 2), np.inf)
        for row, (pos, rot) in enumerate(zip(path.pos, path.rot, strict=True)):
            self._task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(rot), pos))
            errors[row] = self._reach(ITERATIONS if row else FIRST_ITERATIONS)
            if errors[row, 0] > GIVE_UP_M:
                break
            joint_pos[row] = self._configuration.q[self._qpos]
        return joint_pos, np.minimum(errors, GIVE_UP_M * 10)

    def _reach(self, most: int) -> tuple[float, float]:
        """Steps towards the pose; returns by how much it is missed, m and rad."""
        for _ in range(most):
            missed = self._missed()
            if missed[0] < POSITION_TOLERANCE_M and missed[1] < TURN_TOLERANCE_RAD:
                return missed
            velocity = mink.solve_ik(
                self._configuration, [self._task, self._posture], STEP_S, "daqp", limits=self._limits
            )
            self._configuration.integrate_inplace(velocity, STEP_S)
        return self._missed()

    def _missed(self) -> tuple[float, float]:
        error = self._task.compute_error(self._configuration)
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
