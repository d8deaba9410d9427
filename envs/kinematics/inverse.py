"""Joint targets for paths of the end effector, by mink's differential inverse kinematics.

Every control step takes a few steps of ``mink.solve_ik`` on the frame of the end effector and on the posture
at rest, with DAQP, inside the joint limits. N paths are followed together: mink, MuJoCo and DAQP take what is
particular to a path, one after another, and the rest is arrays of all paths. Every number is that of
``mink.solve_ik``, bit by bit, for any N.
"""

from collections.abc import Sequence
from ctypes import c_int

import daqp
import mink
import numpy as np

from envs.kinematics.batched_inverse import DAMPING, ITERATIONS_PER_STEP, ORIENTATION_COST, POSTURE_COST
from envs.kinematics.waypoints import Path, Waypoint, interpolate
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.rotations import conjugate, from_euler, multiply, to_euler
from envs.scenario import RobotCfg, ScenarioCfg

_ERRORS = 6
"""Rows of the frame's error, before those of the posture's."""


class PathFollower:
    """Turns waypoints into joint targets for one robot.

    Args:
        robot: The robot; ``ee_site`` follows the path, the gripper's joints follow ``gripper``.
        control_hz: Targets per second.
    """

    def __init__(self, robot: RobotCfg, control_hz: float) -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        self._robot, self._control_hz = robot, control_hz
        self._model = build_model(scenario)
        self._layout = layout_of(self._model, scenario).robots[0]
        self._site = f"{robot.name}/{robot.ee_site}"
        self._configuration = mink.Configuration(self._model)
        self._frames: list[mink.FrameTask] = []  # one for each path
        self._rest = self._full(np.array(robot.default_qpos))
        self._posture = POSTURE_COST * np.eye(self._model.nv)
        self._limit = limit = mink.ConfigurationLimit(self._model)
        chosen = limit.projection_matrix
        chosen = np.zeros((0, self._model.nv)) if chosen is None else chosen
        self._sides = np.vstack([chosen, -chosen])
        self._limited = np.concatenate([limit.indices, self._model.nv + limit.indices]).astype(int)
        self._no_lower = np.full(len(self._sides), -1e30)
        self._inequalities = np.zeros(len(self._sides), c_int)
        self._down = self._site_pose(np.array(robot.default_qpos)).rotation().wxyz

    def joint_targets(self, qpos: np.ndarray, waypoints: Sequence[Waypoint]) -> np.ndarray:
        """Returns joint targets (T, J) that lead the end effector from ``qpos`` (J,) along the waypoints."""
        return self.targets_of_all(qpos[None], [waypoints])[0]

    def targets_of_all(self, qpos: np.ndarray, ways: Sequence[Sequence[Waypoint]]) -> list[np.ndarray]:
        """Returns joint targets, of N ways from ``qpos`` (N, J), each (T, J) as of that way alone."""
        paths = [self._path(start, way) for start, way in zip(qpos, ways, strict=True)]
        order = sorted(range(len(paths)), key=lambda row: -len(paths[row].pos))  # who is going comes first
        goals = [(paths[row].pos, multiply(from_euler(paths[row].turn), self._down)) for row in order]
        self._frames += [self._frame() for _ in range(len(paths) - len(self._frames))]
        q = np.stack([self._full(qpos[row]) for row in order])
        targets = [np.empty((len(pos), len(self._layout.qpos))) for pos, _ in goals]
        for step in range(len(goals[0][0])):
            going = sum(step < len(pos) for pos, _ in goals)
            for frame, (pos, rot) in zip(self._frames, goals[:going], strict=False):
                frame.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(rot[step]), pos[step]))
            for _ in range(ITERATIONS_PER_STEP):
                self._approach(q[:going])
            for row in range(going):
                targets[row][step] = q[row, self._layout.qpos]
        found = dict(zip(order, targets, strict=True))
        for row, path in enumerate(paths):
            found[row][:, self._robot.fingers] = self._robot.finger_positions(path.gripper)
        return [found[row] for row in range(len(paths))]

    def _path(self, qpos: np.ndarray, waypoints: Sequence[Waypoint]) -> Path:
        start = self._site_pose(qpos)
        yaw, pitch, roll = to_euler(multiply(start.rotation().wxyz, conjugate(self._down)))
        first = Waypoint(
            pos=start.translation(), yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0
        )
        return interpolate(first, waypoints, self._control_hz)

    def _frame(self) -> mink.FrameTask:
        return mink.FrameTask(
            frame_name=self._site,
            frame_type="site",
            position_cost=1.0,
            orientation_cost=ORIENTATION_COST,
            lm_damping=DAMPING,
        )

    def _approach(self, q: np.ndarray) -> None:
        """Brings postures (N, K) one step of ``mink.solve_ik`` nearer to the targets of their frames."""
        count, joints = q.shape
        jacobian = np.empty((count, _ERRORS + joints, joints))
        error, damping = np.empty((count, _ERRORS + joints)), np.empty(count)
        jacobian[:, _ERRORS:], error[:, _ERRORS:] = self._posture, POSTURE_COST * (self._rest - q)
        for row in range(count):
            self._configuration.update(q[row])
            found = self._frames[row].compute_qp_residual(self._configuration)
            jacobian[row, :_ERRORS], error[row, :_ERRORS], damping[row] = found
        hessian = jacobian.transpose(0, 2, 1) @ jacobian
        hessian.reshape(count, -1)[:, :: joints + 1] += (DAMPING + damping)[:, None]
        gradient = -(error[:, None] @ jacobian)[:, 0]
        limit = self._limit
        room = limit.gain * np.concatenate([limit.upper - q, q - limit.lower], axis=1)
        room = room.take(self._limited, axis=1)  # each row in one piece: DAQP knows no strides
        changes, dt = np.empty((count, joints)), 1.0 / self._control_hz
        for row in range(count):
            change, _, status, _ = daqp.solve(
                hessian[row], gradient[row], self._sides, room[row], self._no_lower, self._inequalities
            )
            if status <= 0:
                raise mink.NoSolutionFound("daqp")
            changes[row] = change
        q += changes / dt * dt  # a velocity, for a control step

    def _full(self, qpos: np.ndarray) -> np.ndarray:
        full = np.zeros(self._model.nq)
        full[self._layout.qpos] = qpos
        return full

    def _site_pose(self, qpos: np.ndarray) -> mink.SE3:
        self._configuration.update(self._full(qpos))
        site = self._configuration.data.site(self._site)
        rotation = mink.SO3.from_matrix(site.xmat.reshape(3, 3))
        return mink.SE3.from_rotation_and_translation(rotation, site.xpos.copy())
