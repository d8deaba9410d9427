"""PickCube, after ManiSkill 3 (``mani_skill/envs/tasks/tabletop/pick_cube.py``, Apache-2.0).

Sizes, ranges and success are ManiSkill's, but for the horizon: its 50 steps are made for
end-effector deltas; 100 steps of joint positions are the same 5 s at 20 Hz.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
from torch import Tensor

from envs.array_ops import at_least, concatenate, norm, stack
from envs.kinematics.waypoints import Waypoint, correction_s, grasp_yaw
from envs.rotations import from_yaw, yaw_of
from envs.scenario import GeomCfg, ObjectCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.parameters import parameter
from envs.tasks.robot_columns import columns_of
from envs.tasks.skills.from_above import grasp
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    STATIC_SPEED_RAD_S,
    TABLETOP_LOOKS,
    arm_speed,
    distance,
    ee_pos,
    grips_something,
    nearness,
    wrist_camera,
)

HALF_SIZE_M = (0.008, 0.036)
"""Half sizes of a cube that the gripper can take: it opens to 80 mm, and its fingertips are 8 mm high."""

MARKER_MISSES_M = (0.05, 0.03)
"""Standard deviation along each axis of the points beside the marker that the expert passes, in order.

A policy carries it up to 10 cm past the marker, so demonstrations come back from there (the idea of DART,
arXiv:1703.09327).
"""

LARGEST_MISS_M = 0.08
"""Bound of these misses along each axis: a Panda that reaches farther turns its joints too fast."""


@dataclass(frozen=True, kw_only=True)
class PickCube(Task):
    """Grasp a cube and hold it at the marker, or (``variant="lift"``) lift it by 10 cm.

    Attributes:
        variant: ``goal`` is ManiSkill's task; ``lift`` is that of the paper's code (snapshot of June 2025).
        cube_half_size_m: Half the cube's edge, m.
        cube_mass_kg: Its mass, kg; by default that of 4 cm at ManiSkill's default density, 1000 kg/m³.
        spawn_half_size_m: Half width of the square round the origin in which cube and marker start, m.
        goal_height_m: Largest height of the marker above the cube's start, m.
        goal_tolerance_m: Distance from the marker at which the cube has arrived, and the marker's radius, m.
        lift_height_m: Height above its start to which ``lift`` demands the cube, m.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad.
        approach_noise_m: Standard deviation of where the expert begins to come down on the cube, m.
    """

    name: ClassVar[str] = "PickCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "pick up the red cube and hold it at the green marker",
        "move the red cube to the green ball",
        "grasp the cube and bring it to the green marker",
    )
    max_episode_steps: ClassVar[int] = 100
    takes_arrays: ClassVar[bool] = True

    variant: Literal["goal", "lift"] = "goal"
    cube_half_size_m: float = parameter(0.02, at_least=HALF_SIZE_M[0], at_most=HALF_SIZE_M[1])
    cube_mass_kg: float = parameter(0.064, above=0.0, at_most=2.0)
    spawn_half_size_m: float = parameter(0.1, at_least=0.0, at_most=0.2)
    goal_height_m: float = parameter(0.3, at_least=0.0, at_most=0.5)
    goal_tolerance_m: float = parameter(0.025, above=0.0, at_most=0.1)
    lift_height_m: float = parameter(0.1, above=0.0, at_most=0.4)
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)
    approach_noise_m: float = parameter(0.015, at_least=0.0, at_most=0.1)

    @property
    @override
    def robot(self) -> RobotCfg:
        return FRANKA_AT_TABLE

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        cube = ObjectCfg(
            name="cube",
            geoms=(
                GeomCfg(
                    shape="box",
                    size=(self.cube_half_size_m,) * 3,
                    mass_kg=self.cube_mass_kg,
                    rgba=(0.85, 0.08, 0.08, 1.0),
                ),
            ),
            pos=(0.0, 0.0, self.cube_half_size_m),
        )
        goal = ObjectCfg(
            name="goal",
            geoms=(GeomCfg(shape="sphere", size=(self.goal_tolerance_m,), rgba=(0.1, 0.8, 0.15, 1.0)),),
            pos=(0.0, 0.0, 0.2),
            kind="marker",
        )
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(cube, goal) if self.variant == "goal" else (cube,),
            cameras=(FRONT_CAMERA, wrist_camera(self.robot)),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos = np.tile(np.array(own.default_qpos), (count, 1))
        cube, cube_yaw, goal = np.empty((count, 3)), np.empty(count), np.empty((count, 3))
        for row, rng in enumerate(rngs):
            cube[row, :2] = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
            cube_yaw[row] = rng.uniform(-np.pi, np.pi)
            goal[row, :2] = rng.uniform(-self.spawn_half_size_m, self.spawn_half_size_m, 2)
            goal[row, 2] = rng.uniform(0.0, self.goal_height_m) + self.cube_half_size_m
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        cube[:, 2] = self.cube_half_size_m
        objects = {"cube": EntityState.at_rest(cube, from_yaw(cube_yaw))}
        if self.variant == "goal":
            objects["goal"] = EntityState.at_rest(goal, from_yaw(np.zeros(count)))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        return State({own.name: robot}, objects)

    @override
    def success(self, state: State) -> Tensor:
        if self.variant == "lift":
            return state.objects["cube"].pos[:, 2] >= self.cube_half_size_m + self.lift_height_m
        still = arm_speed(state.robots[self.robot.name], self.robot) <= STATIC_SPEED_RAD_S
        return (self._left(state) <= self.goal_tolerance_m) & still

    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's normalized dense reward: reach, grasp, place, be still."""
        left = self._left(state)
        robot = state.robots[self.robot.name]
        reach = distance(ee_pos(robot), state.objects["cube"].pos)
        speed = norm(robot.joint_vel[:, columns_of(self.robot).arm])
        reached, near, still = nearness(stack((reach, left, speed)))
        grasped = self._grasped(robot, reach)
        placed = left <= self.goal_tolerance_m
        return 0.2 * (reached + grasped * (1.0 + near) + placed * still)

    def observe(self, state: State) -> Tensor:
        """Returns cube pose, goal, end effector, and the way between them, (N, 19) or (N, 13)."""
        robot, cube = state.robots[self.robot.name], state.objects["cube"]
        hand = ee_pos(robot)
        parts = [cube.pos, cube.rot, hand, cube.pos - hand]
        if self.variant == "goal":
            goal = state.objects["goal"].pos
            parts += [goal, goal - cube.pos]
        return concatenate(parts)

    @override
    def rl_observation(self, state: State) -> Tensor:
        """Returns joints, what :meth:`observe` gives, and whether the cube is grasped (ManiSkill), (N, D).

        Without the last an agent that descends with an open gripper opens it whenever its hand rises.
        """
        robot = state.robots[self.robot.name]
        grasped = self._grasped(robot, distance(ee_pos(robot), state.objects["cube"].pos))
        return concatenate((super().rl_observation(state), 1.0 * grasped[:, None]))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        cube = state.objects["cube"]
        position = cube.pos[0].numpy()
        yaw = grasp_yaw(float(yaw_of(cube.rot[0].numpy())))
        if self.variant == "goal":
            target = state.objects["goal"].pos[0].numpy()
        else:
            target = position + np.array([0.0, 0.0, self.lift_height_m + 0.05])
        # All ends first miss, the marker twice: the next motion demonstrates the correction.
        above = position + np.array([*rng.normal(0.0, self.approach_noise_m, 2), rng.uniform(0.06, 0.09)])
        grip, over = GRASP_CLOSED_M, Waypoint(pos=above, yaw=yaw, gripper=GRASP_OPEN_M, duration_s=0.6)
        come = grasp(over, position, rng, 0.05, down_s=0.3, close_s=0.2)
        near, nearer = (self._beside(target, rng, noise_m) for noise_m in MARKER_MISSES_M)
        carry = 0.25 + 1.3 * float(np.linalg.norm(near - position))
        back = 0.1 + correction_s(nearer - near)
        home = 0.25 + 2.0 * max(0.0, float(np.linalg.norm(nearer - target)) - 0.03)
        return [
            *come,
            Waypoint(pos=near, yaw=yaw, gripper=grip, duration_s=carry),
            Waypoint(pos=nearer, yaw=yaw, gripper=grip, duration_s=back),
            Waypoint(pos=target, yaw=yaw, gripper=grip, duration_s=home, hold_s=1.0),
        ]

    def _beside(self, target: np.ndarray, rng: np.random.Generator, noise_m: float) -> np.ndarray:
        """Returns a point beside the marker, within the arm's reach and not below the table, m, (3,)."""
        point = target + np.clip(rng.normal(0.0, noise_m, 3), -LARGEST_MISS_M, LARGEST_MISS_M)
        point[2] = max(point[2], self.cube_half_size_m)
        return point

    def _grasped(self, robot: EntityState, reach_m: Tensor) -> Tensor:
        """Returns whether the fingers hold the cube, whose centre is ``reach_m`` (N,) away, (N,)."""
        return (reach_m < self.cube_half_size_m) & grips_something(
            robot, 1.5 * self.cube_half_size_m, self.robot
        )

    def _left(self, state: State) -> Tensor:
        """Returns how far the cube still has to go, (N,), m."""
        cube = state.objects["cube"].pos
        if self.variant == "lift":
            return at_least(round(self.cube_half_size_m + self.lift_height_m, 9) - cube[:, 2], 0.0)
        return distance(cube, state.objects["goal"].pos)
