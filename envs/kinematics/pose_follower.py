"""Joint targets along a dense path of one end effector, by damped least squares with MuJoCo's Jacobian.

The objective is that of :mod:`envs.kinematics.inverse`: position, orientation, posture and damping with the
same weights. Where the path has a pose for every control step, the way between two is short, so that a step
of Gauss and Newton replaces a QP, in a quarter of its time. Joints that would leave their limits are fixed
there.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from envs.kinematics.batched_inverse import DAMPING, ORIENTATION_COST, POSTURE_COST
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.scenario import RobotCfg, ScenarioCfg

MAX_ITERATIONS = 4
"""Most Gauss-Newton steps per pose."""

DONE_M = 3e-4
"""A pose is reached when it is missed by less; a radian counts as :data:`ORIENTATION_COST` metres."""


class Followed(NamedTuple):
    """A path followed by a robot.

    Attributes:
        targets: Joint targets, (T, J) float64; joints that do not move the end effector stay.
        errors_m: Distance by which each pose is missed, (T,).
        errors_rad: Likewise, its orientation, (T,).
    """

    targets: np.ndarray
    errors_m: np.ndarray
    errors_rad: np.ndarray


class PoseFollower:
    """Follows paths of poses with one robot.

    Args:
        robot: The robot; its ``ee_site`` follows.
    """

    def __init__(self, robot: RobotCfg) -> None:
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        self._model = build_model(scenario)
        layout = layout_of(self._model, scenario).robots[0]
        self._data = mujoco.MjData(self._model)
        self._site, self._qpos, self._qvel = layout.ee_site, layout.qpos, layout.qvel
        self._rest = np.array(robot.default_qpos)
        self._low, self._high = np.array([joint.range for joint in robot.joints]).T
        self._moving = self._joints_of_site()
        self._squares = np.array([1.0] * 3 + [ORIENTATION_COST] * 3) ** 2
        self._jacobian = np.zeros((6, self._model.nv))
        moving = self._moving
        self._columns, self._identity = self._qvel[moving], np.eye(len(moving))
        self._rest, self._low, self._high = self._rest[moving], self._low[moving], self._high[moving]

    def pose(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the end effector's position (3,) and orientation (4,) at joint positions (J,)."""
        self._set(qpos)
        rot = np.empty(4)
        mujoco.mju_mat2Quat(rot, self._data.site_xmat[self._site])
        return self._data.site_xpos[self._site].copy(), rot

    def follow(self, qpos: np.ndarray, pos: np.ndarray, rot: np.ndarray) -> Followed:
        """Returns joint targets that lead the end effector from ``qpos`` through every pose.

        Args:
            qpos: Where it starts, (J,).
            pos: Positions in the world, m, (T, 3).
            rot: Orientations, wxyz, (T, 4).
        """
        full = np.array(qpos, np.float64)
        targets = np.tile(full, (len(pos), 1))
        errors = np.empty((len(pos), 2))
        moving = self._moving
        for step in range(len(pos)):
            error = self._error(full, pos[step], rot[step])
            for _ in range(MAX_ITERATIONS):
                if (error**2 @ self._squares) < DONE_M**2:
                    break
                full[moving] += self._change(full[moving], error)
                error = self._error(full, pos[step], rot[step])
            targets[step] = full
            errors[step] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
        return Followed(targets, errors[:, 0], errors[:, 1])

    def _set(self, qpos: np.ndarray) -> None:
        self._data.qpos[self._qpos] = qpos
        mujoco.mj_kinematics(self._model, self._data)

    def _error(self, qpos: np.ndarray, pos: np.ndarray, rot: np.ndarray) -> np.ndarray:
        """Returns the way and the turn in the world to a pose, (6,), m and rad."""
        here, now = self.pose(qpos)
        back, turn, error = np.empty(4), np.empty(4), np.empty(6)
        mujoco.mju_negQuat(back, now)
        mujoco.mju_mulQuat(turn, rot, back)
        mujoco.mju_quat2Vel(error[3:], turn, 1.0)
        error[:3] = pos - here
        return error

    def _change(self, q: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Returns the change (K,) of the moving joints towards a pose, inside their limits."""
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, self._jacobian[:3], self._jacobian[3:], self._site)
        jacobian = self._jacobian[:, self._columns]
        weighted = jacobian.T * self._squares
        damping = DAMPING + DAMPING * (error**2 @ self._squares) + POSTURE_COST**2
        hessian = weighted @ jacobian + damping * self._identity
        gradient = weighted @ error + POSTURE_COST**2 * (self._rest - q)
        change = np.linalg.solve(hessian, gradient)
        low, high = self._low - q, self._high - q
        inside = np.clip(change, low, high)
        stuck = inside != change
        if stuck.any() and not stuck.all():  # the others make up for those at their limits
            free = ~stuck
            rest = gradient[free] - hessian[np.ix_(free, stuck)] @ inside[stuck]
            inside[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest)
            inside = np.clip(inside, low, high)
        return inside

    def _joints_of_site(self) -> np.ndarray:
        """Returns which of the robot's joints move the end effector, (K,)."""
        body, above = int(self._model.site_bodyid[self._site]), set[int]()
        while body:
            above.add(body)
            body = int(self._model.body_parentid[body])
        bodies = self._model.dof_bodyid[self._qvel].tolist()
        return np.array([index for index, body in enumerate(bodies) if body in above], np.intp)
