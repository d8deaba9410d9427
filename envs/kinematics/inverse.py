"""Joint targets for a path of the end effector, by mink's differential inverse kinematics."""

from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from envs.kinematics.batched_inverse import DAMPING, ITERATIONS_PER_STEP, ORIENTATION_COST, POSTURE_COST
from envs.kinematics.waypoints import Waypoint, interpolate
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.rotations import conjugate, from_euler, multiply, to_euler
from envs.scenario import RobotCfg, ScenarioCfg


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
        self._task = mink.FrameTask(
            frame_name=self._site,
            frame_type="site",
            position_cost=1.0,
            orientation_cost=ORIENTATION_COST,
            lm_damping=DAMPING,
        )
        self._posture = mink.PostureTask(self._model, cost=POSTURE_COST)
        self._limits = [mink.ConfigurationLimit(self._model)]
        self._down = self._site_pose(np.array(robot.default_qpos)).rotation().wxyz

    def joint_targets(self, qpos: np.ndarray, waypoints: Sequence[Waypoint]) -> np.ndarray:
        """Returns joint targets (T, J) that lead the end effector from ``qpos`` (J,) along the waypoints."""
        start = self._site_pose(qpos)
        yaw, pitch, roll = to_euler(multiply(start.rotation().wxyz, conjugate(self._down)))
        first = Waypoint(
            pos=start.translation(), yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0
        )
        path = interpolate(first, waypoints, self._control_hz)
        self._posture.set_target(self._full(np.array(self._robot.default_qpos)))
        self._configuration.update(self._full(qpos))
        targets = np.empty((len(path.pos), len(self._layout.qpos)))
        rotations = multiply(from_euler(path.turn), self._down)
        for step, (pos, rot) in enumerate(zip(path.pos, rotations, strict=True)):
            rotation = mink.SO3(rot)
            self._task.set_target(mink.SE3.from_rotation_and_translation(rotation, pos))
            self._follow()
            targets[step] = self._configuration.q[self._layout.qpos]
        targets[:, self._robot.fingers] = self._robot.finger_positions(path.gripper)
        return targets

    def _follow(self) -> None:
        dt = 1.0 / self._control_hz
        for _ in range(ITERATIONS_PER_STEP):
            velocity = mink.solve_ik(
                self._configuration,
                [self._task, self._posture],
                dt,
                "daqp",
                damping=DAMPING,
                limits=self._limits,
            )
            self._configuration.integrate_inplace(velocity, dt)

    def _full(self, qpos: np.ndarray) -> np.ndarray:
        full = np.zeros(self._model.nq)
        full[self._layout.qpos] = qpos
        return full

    def _site_pose(self, qpos: np.ndarray) -> mink.SE3:
        data = mujoco.MjData(self._model)
        data.qpos[:] = self._full(qpos)
        mujoco.mj_kinematics(self._model, data)
        site = data.site(self._site)
        rotation = mink.SO3.from_matrix(site.xmat.reshape(3, 3))
        return mink.SE3.from_rotation_and_translation(rotation, site.xpos.copy())
