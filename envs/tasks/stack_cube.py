"""StackCube, after ManiSkill 3 (``mani_skill/envs/tasks/tabletop/stack_cube.py``, Apache-2.0).

Sizes, ranges and success are ManiSkill's. Its grasp test reads contact forces, which a state does
not have; here the cube is grasped when it keeps closing fingers apart.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import unknown_name
from envs.kinematics.waypoints import Waypoint, approach, correction_s, grasp_yaw, miss
from envs.rotations import from_yaw, yaw_of
from envs.scenario import GeomCfg, ObjectCfg, Rgba, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRANKA_AT_TABLE,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    WRIST_CAMERA,
    distance,
    ee_pos,
    finger_gap,
    hand_yaw,
    nearness,
)

CUBE_HALF_SIZE_M = 0.02
CUBE_MASS_KG = 0.064
"""4 cm cube at ManiSkill's default density, 1000 kg/m³."""

SPAWN_OFFSET_M = 0.1
"""Both cubes are moved together by up to this along x and y."""

SPAWN_HALF_SIZE_M = (0.1, 0.2)
"""Each cube is placed in a box of these half extents round that offset."""

MIN_SEPARATION_M = 2 * (np.sqrt(2) * CUBE_HALF_SIZE_M + 0.001)
"""Cubes' centres are farther apart, so that they never touch, whatever their yaw."""

TOLERANCE_XY_M = np.sqrt(2) * CUBE_HALF_SIZE_M + 0.005
TOLERANCE_Z_M = 0.005
STATIC_SPEED_M_S, STATIC_SPEED_RAD_S = 1e-2, 0.5

PAPER_TOLERANCE_M = 0.02
"""The variant of the paper's code (snapshot of June 2025), along each axis."""

GRASP_REACH_M = 0.04
GRASP_GAP_M = (0.03, 2 * np.sqrt(2) * CUBE_HALF_SIZE_M + 0.002)
"""Gaps between fingers that a cube keeps apart: its side, or at most its diagonal."""

QPOS_NOISE_RAD = 0.02
APPROACH_NOISE_M = 0.01
DETOUR_M = 0.03
"""Lateral offset of the expert's detours, in three of ten motions; 0.05 m reaches joint limits."""
CARRY_HEIGHT_M = 0.06
"""Height above its place on the other cube at which the expert carries a cube."""

_ROBOT = FRANKA_AT_TABLE
_CAMERA = dataclasses.replace(FRONT_CAMERA, fovy_deg=30.0)
"""Wider than PickCube's: cubes lie up to 0.3 m to either side."""

_ON_TOP = torch.tensor([0.0, 0.0, 2 * CUBE_HALF_SIZE_M], dtype=torch.float64)


@dataclass(frozen=True, kw_only=True)
class StackCube(Task):
    """Put the red cube on the green cube and let go of it.

    Attributes:
        variant: ``stack`` is ManiSkill's task. ``roboverse`` is that of the paper's code: the red cube is
            within 2 cm of its place on the green cube along each axis, held or not, moving or not. That
            code takes the green cube's place at the start of the episode; a state has only its present
            place, so the two differ when the green cube has been pushed.
    """

    name: ClassVar[str] = "StackCube"
    instructions: ClassVar[tuple[str, ...]] = (
        "stack the red cube on the green cube",
        "pick up the red cube and put it on top of the green cube",
        "place the red cube on the green one and let go of it",
    )
    max_episode_steps: ClassVar[int] = 200

    variant: Literal["stack", "roboverse"] = "stack"

    def __post_init__(self) -> None:
        if self.variant not in ("stack", "roboverse"):
            raise unknown_name("variant of StackCube", str(self.variant), ("stack", "roboverse"))

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=(_ROBOT,),
            objects=(
                _cube("cube_a", (0.85, 0.08, 0.08, 1.0), 0.05),
                _cube("cube_b", (0.08, 0.7, 0.12, 1.0), -0.05),
            ),
            cameras=(_CAMERA, WRIST_CAMERA),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(-0.12, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count = len(rngs)
        qpos = np.tile(np.array(_ROBOT.default_qpos), (count, 1))
        pos, yaw = np.full((count, 2, 3), CUBE_HALF_SIZE_M), np.empty((count, 2))
        for row, rng in enumerate(rngs):
            offset = rng.uniform(-SPAWN_OFFSET_M, SPAWN_OFFSET_M, 2)
            pos[row, :, :2] = offset + _two_places(rng)
            yaw[row] = rng.uniform(-np.pi, np.pi, 2)
            qpos[row, :7] += rng.normal(0.0, QPOS_NOISE_RAD, 7)
        robot = EntityState.at_rest(np.array(_ROBOT.pos), np.tile(_ROBOT.rot, (count, 1)), qpos)
        cubes = {
            name: EntityState.at_rest(pos[:, i], from_yaw(yaw[:, i]))
            for i, name in enumerate(("cube_a", "cube_b"))
        }
        return State({_ROBOT.name: robot}, cubes)

    @override
    def success(self, state: State) -> Tensor:
        a, robot = state.objects["cube_a"], state.robots[_ROBOT.name]
        if self.variant == "roboverse":
            return (_to_place(state).abs() < PAPER_TOLERANCE_M).all(-1)
        linear, angular = (torch.linalg.vector_norm(v, dim=-1) for v in (a.lin_vel, a.ang_vel))
        static = (linear <= STATIC_SPEED_M_S) & (angular <= STATIC_SPEED_RAD_S)
        return _on_top(state) & static & _released(robot, a.pos)

    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's normalized dense reward: reach, grasp and place, let go and be still."""
        a, robot = state.objects["cube_a"], state.robots[_ROBOT.name]
        released = _released(robot, a.pos)
        reach = 2.0 * nearness(distance(ee_pos(robot), a.pos))
        place = 4.0 + nearness(torch.linalg.vector_norm(_to_place(state), dim=-1))
        opened = torch.where(released, 1.0, finger_gap(robot) / (2 * GRASP_OPEN_M))
        linear, angular = (torch.linalg.vector_norm(v, dim=-1) for v in (a.lin_vel, a.ang_vel))
        rest = 6.0 + 0.5 * (opened + nearness(10.0 * linear + angular, 1.0))
        return torch.where(_on_top(state), rest, torch.where(released, reach, place)) / 8.0

    def observe(self, state: State) -> Tensor:
        """Returns both cubes' poses, the end effector, and the ways between the three, (N, 26)."""
        a, b = state.objects["cube_a"], state.objects["cube_b"]
        hand = ee_pos(state.robots[_ROBOT.name])
        ways = [a.pos - hand, b.pos - hand, b.pos - a.pos]
        return torch.cat([a.pos, a.rot, b.pos, b.rot, hand, *ways], dim=-1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        a, b = (state.objects[name] for name in ("cube_a", "cube_b"))
        robot = state.robots[_ROBOT.name]
        start, base = a.pos[0].numpy(), b.pos[0].numpy()
        yaw = _clear_yaw(float(yaw_of(a.rot[0].numpy())), base[:2] - start[:2])
        hand = ee_pos(robot)[0].numpy()
        up = Waypoint(pos=_higher(hand, 0.08), yaw=hand_yaw(robot), gripper=GRASP_OPEN_M, duration_s=0.5)
        if bool(_on_top(state)[0]):
            return [up]
        # Both ends first miss: the next motion demonstrates the correction.
        above = start + np.array([*rng.normal(0.0, APPROACH_NOISE_M, 2), rng.uniform(0.07, 0.1)])
        place = _higher(base, 2 * CUBE_HALF_SIZE_M)
        hold, grip = GRASP_OPEN_M, GRASP_CLOSED_M
        turn_s = 0.65 + 0.2 * abs(yaw - hand_yaw(robot))
        come = approach(Waypoint(pos=above, yaw=yaw, gripper=hold, duration_s=turn_s), rng, DETOUR_M)
        over = _higher(place, CARRY_HEIGHT_M)
        aside = rng.normal(0.0, miss(rng, often_m=APPROACH_NOISE_M, seldom_m=DETOUR_M), 2)
        near, back = over + np.array([*aside, 0.0]), correction_s(aside)
        lift = np.array([*start[:2], near[2]])
        carry = 0.3 + 1.5 * float(np.linalg.norm(near - lift))
        grasp = [
            *come,
            Waypoint(pos=start, yaw=yaw, gripper=hold, duration_s=0.4, hold_s=0.1),
            Waypoint(pos=start, yaw=yaw, gripper=grip, duration_s=0.25),
        ]
        stack = [
            Waypoint(pos=lift, yaw=yaw, gripper=grip, duration_s=0.5),
            Waypoint(pos=near, yaw=yaw, gripper=grip, duration_s=carry),
            *([Waypoint(pos=over, yaw=yaw, gripper=grip, duration_s=back)] if back > 0.16 else []),
            Waypoint(pos=_higher(place, 0.001), yaw=yaw, gripper=grip, duration_s=0.5, hold_s=0.15),
            Waypoint(pos=place, yaw=yaw, gripper=hold, duration_s=0.3),
            Waypoint(pos=_higher(place, 0.1), yaw=yaw, gripper=hold, duration_s=0.5),
        ]
        low = hand[2] < above[2] - 0.02
        return [*([up] if low else []), *grasp, *stack]


def _cube(name: str, rgba: Rgba, y: float) -> ObjectCfg:
    half = CUBE_HALF_SIZE_M
    geom = GeomCfg(shape="box", size=(half,) * 3, mass_kg=CUBE_MASS_KG, rgba=rgba)
    return ObjectCfg(name=name, geoms=(geom,), pos=(0.0, y, half))


def _higher(pos: np.ndarray, height_m: float) -> np.ndarray:
    return pos + np.array([0.0, 0.0, height_m])


def _two_places(rng: np.random.Generator) -> np.ndarray:
    """Draws places of both cubes, (2, 2): the second again and again until it is clear of the first."""
    places = rng.uniform(-1.0, 1.0, (2, 2)) * SPAWN_HALF_SIZE_M
    while np.linalg.norm(places[1] - places[0]) <= MIN_SEPARATION_M:
        places[1] = rng.uniform(-1.0, 1.0, 2) * SPAWN_HALF_SIZE_M
    return places


def _to_place(state: State) -> Tensor:
    """Returns the way from the red cube to its place on the green one, (N, 3)."""
    a, b = state.objects["cube_a"].pos, state.objects["cube_b"].pos
    return b + _ON_TOP.to(b) - a


def _on_top(state: State) -> Tensor:
    way = _to_place(state)
    near = torch.linalg.vector_norm(way[:, :2], dim=-1) <= TOLERANCE_XY_M
    return near & (way[:, 2].abs() <= TOLERANCE_Z_M)


def _released(robot: EntityState, cube: Tensor) -> Tensor:
    """Returns whether no grasp holds the cube, (N,): False where the robot's state is not finite.

    A recording that has no targets is judged by the gap between its fingers alone.
    """
    gap = finger_gap(robot)
    apart = (distance(ee_pos(robot), cube) > GRASP_REACH_M) | (gap < GRASP_GAP_M[0]) | (gap > GRASP_GAP_M[1])
    if robot.joint_target is None:
        return apart
    return apart | (robot.joint_target[:, 7:9].sum(-1) >= gap - 0.001)


def _clear_yaw(cube_yaw: float, to_other: np.ndarray) -> float:
    """Returns the turn of the gripper that grasps a cube and keeps its fingers off the other one.

    At turn 0 the fingers close along y; of the two pairs of faces, the one less in line with the other
    cube is taken when that is near.
    """
    yaw = grasp_yaw(cube_yaw)
    turned = yaw - np.copysign(np.pi / 2, yaw)
    towards = [abs(to_other @ (-np.sin(angle), np.cos(angle))) for angle in (yaw, turned)]
    near = np.linalg.norm(to_other) < 0.12
    return float(turned if near and towards[0] > towards[1] else yaw)
