"""StackCube, after ManiSkill 3 (``mani_skill/envs/tasks/tabletop/stack_cube.py``, Apache-2.0).

Sizes, ranges and success are ManiSkill's. Its grasp test reads contact forces, which a state does
not have; here the cube is grasped when it keeps closing fingers apart.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint, correction_s, grasp_yaw, miss
from envs.rotations import from_yaw, yaw_of
from envs.scenario import GeomCfg, ObjectCfg, Rgba, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import above
from envs.tasks.base import Task
from envs.tasks.parameters import parameter
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    finger_gap,
    hand_yaw,
    nearness,
    target_gap,
    wrist_camera,
)

HALF_SIZE_M = (0.01, 0.036)
"""Half sizes of cubes that the gripper can take: it opens to 80 mm."""

_CAMERA = dataclasses.replace(FRONT_CAMERA, fovy_deg=30.0)
"""Wider than PickCube's: cubes lie up to 0.3 m to either side."""


@dataclass(frozen=True, kw_only=True)
class StackCube(Task):
    """Put the red cube on the green cube and let go of it.

    Attributes:
        variant: ``stack`` is ManiSkill's task. ``roboverse`` is that of the paper's code: the red cube is
            within 2 cm of its place on the green cube along each axis, held or not, moving or not. That
            code takes the green cube's place at the start of the episode; a state has only its present
            place, so the two differ when the green cube has been pushed.
        cube_half_size_m: Half the edge of both cubes, m.
        cube_mass_kg: Mass of each, kg; by default that of 4 cm at ManiSkill's default density, 1000 kg/m³.
        spawn_offset_m: Both cubes are moved together by up to this along x and y, m.
        spawn_half_size_m: Half widths of the box round that offset in which each cube starts, x and y, m.
        tolerance_xy_m: How much farther than half its diagonal the red cube may be off the green one's
            middle, m.
        tolerance_z_m: How far its height may be off, m.
        static_speed_m_s: Largest speed of a red cube that is still, m/s.
        static_speed_rad_s: Its largest angular speed, rad/s.
        roboverse_tolerance_m: The variant ``roboverse``: tolerance along each axis, m.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad.
        approach_noise_m: Standard deviation of where the expert begins to come down on the cube, m.
        detour_m: Lateral offset of the expert's detours, in three of ten motions, m; 0.05 reaches joint
            limits.
        carry_height_m: Height above its place on the other cube at which the expert carries a cube, m.
    """

    name: ClassVar[str] = "StackCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "stack the red cube on the green cube",
        "pick up the red cube and put it on top of the green cube",
        "place the red cube on the green one and let go of it",
    )
    max_episode_steps: ClassVar[int] = 200

    variant: Literal["stack", "roboverse"] = "stack"
    cube_half_size_m: float = parameter(0.02, at_least=HALF_SIZE_M[0], at_most=HALF_SIZE_M[1])
    cube_mass_kg: float = parameter(0.064, above=0.0, at_most=2.0)
    spawn_offset_m: float = parameter(0.1, at_least=0.0, at_most=0.2)
    spawn_half_size_m: tuple[float, float] = parameter((0.1, 0.2), at_least=0.0, at_most=0.3)
    tolerance_xy_m: float = parameter(0.005, at_least=0.0, at_most=0.05)
    tolerance_z_m: float = parameter(0.005, above=0.0, at_most=0.02)
    static_speed_m_s: float = parameter(1e-2, above=0.0)
    static_speed_rad_s: float = parameter(0.5, above=0.0)
    roboverse_tolerance_m: float = parameter(0.02, above=0.0, at_most=0.1)
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)
    approach_noise_m: float = parameter(0.01, at_least=0.0, at_most=0.1)
    detour_m: float = parameter(0.03, at_least=0.0, at_most=0.1)
    carry_height_m: float = parameter(0.06, at_least=0.02, at_most=0.2)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 2 * math.hypot(*self.spawn_half_size_m) < 1.5 * self._separation_m:
            raise ConfigError(
                f"spawn_half_size_m of StackCube is {self.spawn_half_size_m!r}: two cubes with "
                f"cube_half_size_m={self.cube_half_size_m:g} do not fit. Its diagonal must be at least "
                f"{1.5 * self._separation_m:.3f} m."
            )

    @property
    @override
    def robot(self) -> RobotCfg:
        return FRANKA_AT_TABLE

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(
                self._cube("cube_a", (0.85, 0.08, 0.08, 1.0), 0.05),
                self._cube("cube_b", (0.08, 0.7, 0.12, 1.0), -0.05),
            ),
            cameras=(_CAMERA, wrist_camera(self.robot)),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos = np.tile(np.array(own.default_qpos), (count, 1))
        pos, yaw = np.full((count, 2, 3), self.cube_half_size_m), np.empty((count, 2))
        for row, rng in enumerate(rngs):
            offset = rng.uniform(-self.spawn_offset_m, self.spawn_offset_m, 2)
            pos[row, :, :2] = offset + self._two_places(rng)
            yaw[row] = rng.uniform(-np.pi, np.pi, 2)
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        cubes = {
            name: EntityState.at_rest(pos[:, i], from_yaw(yaw[:, i]))
            for i, name in enumerate(("cube_a", "cube_b"))
        }
        return State({own.name: robot}, cubes)

    @override
    def success(self, state: State) -> Tensor:
        a, robot = state.objects["cube_a"], state.robots[self.robot.name]
        if self.variant == "roboverse":
            return (self._to_place(state).abs() < self.roboverse_tolerance_m).all(-1)
        linear, angular = (torch.linalg.vector_norm(v, dim=-1) for v in (a.lin_vel, a.ang_vel))
        static = (linear <= self.static_speed_m_s) & (angular <= self.static_speed_rad_s)
        return self._on_top(state) & static & self._released(robot, a.pos)

    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's normalized dense reward: reach, grasp and place, let go and be still."""
        a, robot = state.objects["cube_a"], state.robots[self.robot.name]
        released = self._released(robot, a.pos)
        reach = 2.0 * nearness(distance(ee_pos(robot), a.pos))
        place = 4.0 + nearness(torch.linalg.vector_norm(self._to_place(state), dim=-1))
        opened = torch.where(released, 1.0, finger_gap(robot, self.robot) / (2 * GRASP_OPEN_M))
        linear, angular = (torch.linalg.vector_norm(v, dim=-1) for v in (a.lin_vel, a.ang_vel))
        rest = 6.0 + 0.5 * (opened + nearness(10.0 * linear + angular, 1.0))
        return torch.where(self._on_top(state), rest, torch.where(released, reach, place)) / 8.0

    def observe(self, state: State) -> Tensor:
        """Returns both cubes' poses, the end effector, and the ways between the three, (N, 26)."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        hand = ee_pos(state.robots[self.robot.name])
        ways = [a.pos - hand, b.pos - hand, b.pos - a.pos]
        return torch.cat([a.pos, a.rot, b.pos, b.rot, hand, *ways], dim=-1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        a, b = (state.objects[name] for name in ("cube_a", "cube_b"))
        robot = state.robots[self.robot.name]
        start, base = a.pos[0].numpy(), b.pos[0].numpy()
        yaw = _clear_yaw(float(yaw_of(a.rot[0].numpy())), base[:2] - start[:2], 6 * self.cube_half_size_m)
        hand = ee_pos(robot)[0].numpy()
        up = Waypoint(pos=above(hand, 0.08), yaw=hand_yaw(robot), gripper=GRASP_OPEN_M, duration_s=0.5)
        if bool(self._on_top(state)[0]):
            return [up]
        # Both ends first miss: the next motion demonstrates the correction.
        over_cube = start + np.array([*rng.normal(0.0, self.approach_noise_m, 2), rng.uniform(0.07, 0.1)])
        top = above(base, 2 * self.cube_half_size_m)
        hold, grip = GRASP_OPEN_M, GRASP_CLOSED_M
        turn_s = 0.65 + 0.2 * abs(yaw - hand_yaw(robot))
        come = Waypoint(pos=over_cube, yaw=yaw, gripper=hold, duration_s=turn_s)
        take = grasp(come, start, rng, self.detour_m, down_s=0.4, close_s=0.25)
        over = above(top, self.carry_height_m)
        aside = rng.normal(0.0, miss(rng, often_m=self.approach_noise_m, seldom_m=self.detour_m), 2)
        near, back = over + np.array([*aside, 0.0]), correction_s(aside)
        lift = np.array([*start[:2], near[2]])
        carry = 0.3 + 1.5 * float(np.linalg.norm(near - lift))
        puts = set_down(Waypoint(pos=over, yaw=yaw, gripper=grip, duration_s=back), above(top, 0.001))
        stack = [
            Waypoint(pos=lift, yaw=yaw, gripper=grip, duration_s=0.5),
            Waypoint(pos=near, yaw=yaw, gripper=grip, duration_s=carry),
            *puts[0 if back > 0.16 else 1 :],
        ]
        low = hand[2] < over_cube[2] - 0.02
        return [*([up] if low else []), *take, *stack]

    def _cube(self, name: str, rgba: Rgba, y: float) -> ObjectCfg:
        half = self.cube_half_size_m
        geom = GeomCfg(shape="box", size=(half,) * 3, mass_kg=self.cube_mass_kg, rgba=rgba)
        return ObjectCfg(name=name, geoms=(geom,), pos=(0.0, y, half))

    @property
    def _separation_m(self) -> float:
        """Cubes' centres are farther apart, so that they never touch, whatever their yaw."""
        return 2 * (math.sqrt(2) * self.cube_half_size_m + 0.001)

    def _two_places(self, rng: np.random.Generator) -> np.ndarray:
        """Draws places of both cubes, (2, 2): the second again until it is clear of the first."""
        places = rng.uniform(-1.0, 1.0, (2, 2)) * self.spawn_half_size_m
        while np.linalg.norm(places[1] - places[0]) <= self._separation_m:
            places[1] = rng.uniform(-1.0, 1.0, 2) * self.spawn_half_size_m
        return places

    def _to_place(self, state: State) -> Tensor:
        """Returns the way from the red cube to its place on the green one, (N, 3)."""
        a, b = state.objects["cube_a"].pos, state.objects["cube_b"].pos
        return b + b.new_tensor([0.0, 0.0, 2 * self.cube_half_size_m]) - a

    def _on_top(self, state: State) -> Tensor:
        way = self._to_place(state)
        near = torch.linalg.vector_norm(way[:, :2], dim=-1)
        near = near <= math.sqrt(2) * self.cube_half_size_m + self.tolerance_xy_m
        return near & (way[:, 2].abs() <= self.tolerance_z_m)

    def _released(self, robot: EntityState, cube: Tensor) -> Tensor:
        """Returns whether no grasp holds the cube, (N,): False where the robot's state is not finite.

        A cube keeps the fingers apart by its side, or at most its diagonal. A recording that has no targets
        is judged by the gap between its fingers alone.
        """
        gap, half = finger_gap(robot, self.robot), self.cube_half_size_m
        apart = distance(ee_pos(robot), cube) > 2 * half
        apart = apart | (gap < 1.5 * half) | (gap > 2 * math.sqrt(2) * half + 0.002)
        if robot.joint_target is None:
            return apart
        return apart | (target_gap(robot, self.robot) >= gap - 0.001)


def _clear_yaw(cube_yaw: float, to_other: np.ndarray, near_m: float = 0.12) -> float:
    """Returns the turn of the gripper that grasps a cube and keeps its fingers off the other one.

    At turn 0 the fingers close along y; of the two pairs of faces, the one less in line with the other
    cube is taken when that is nearer than ``near_m``.
    """
    yaw = grasp_yaw(cube_yaw)
    turned = yaw - np.copysign(np.pi / 2, yaw)
    towards = [abs(to_other @ (-np.sin(angle), np.cos(angle))) for angle in (yaw, turned)]
    near = np.linalg.norm(to_other) < near_m
    return float(turned if near and towards[0] > towards[1] else yaw)
