"""Joint targets for a path of the end effector, by mink's differential inverse kinematics."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import mink
import mujoco
import numpy as np
import torch

from envs.kinematics.waypoints import Waypoint, interpolate
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.rotations import conjugate, from_euler, multiply, to_euler
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import State
from envs.tasks.base import Task

if TYPE_CHECKING:
    from envs.kinematics.batched_inverse import BatchedPathFollower

ITERATIONS_PER_STEP = 3
"""Differential steps per control step; a path of 5 cm per step is then followed within 1 mm."""

DAMPING = 1e-3
ORIENTATION_COST = 0.3
"""Metres that a radian is worth: 1° is as bad as 5 mm."""

POSTURE_COST = 5e-3
"""Pull towards the rest posture, which decides what the end effector leaves open."""


class WaypointPlanner:
    """Follows the waypoints of a task's expert.

    Args:
        task: The task; its controller takes joint positions of its first robot.
    """

    def __init__(self, task: Task) -> None:
        scenario = task.scenario
        self._task, self._robot = task, scenario.robots[0]
        self._follower = PathFollower(self._robot, scenario.physics.control_hz)

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns joint targets (T, J) float32; see :class:`envs.tasks.planner.Planner`."""
        robot = state.robots[self._robot.name]
        waypoints = self._task.expert(state, rng)
        if not waypoints:
            return np.zeros((0, len(self._robot.joints)), np.float32)
        # From where the joints are told to be: what they hold may keep them a little behind.
        start = robot.joint_pos if robot.joint_target is None else robot.joint_target
        return self._follower.joint_targets(start[0].numpy(), waypoints).astype(np.float32)

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the plans of all rows of ``state``; see :class:`envs.tasks.planner.BatchPlanner`."""
        robot = state.robots[self._robot.name]
        ways = [self._task.expert(state.select([row]), rng) for row, rng in enumerate(rngs)]
        nothing: np.ndarray = np.zeros((0, len(self._robot.joints)), np.float32)
        plans = [nothing] * len(ways)
        asked = [row for row, way in enumerate(ways) if way]
        if asked:
            start = robot.joint_pos if robot.joint_target is None else robot.joint_target
            found = self._batched.joint_targets(start[asked].numpy(), [ways[row] for row in asked])
            targets = found.targets.cpu().numpy().astype(np.float32)
            for place, row in enumerate(asked):
                plans[row] = targets[place, : found.lengths[place]]
        return plans

    @cached_property
    def _batched(self) -> "BatchedPathFollower":
        from envs.kinematics.batched_inverse import BatchedPathFollower

        device = "cuda" if torch.cuda.is_available() else "cpu"
        return BatchedPathFollower(self._robot, self._task.scenario.physics.control_hz, device)


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
        self._fingers = [robot.joint_names.index(name) for name in robot.gripper_joints]
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
        targets[:, self._fingers] = path.gripper[:, None]
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
