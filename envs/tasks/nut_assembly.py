"""NutAssembly, after robosuite 1.5.1 (``environments/manipulation/nut_assembly.py``, MIT).

Nuts are robosuite's own files; pegs, table, robot base and rest posture have its numbers. Its table top
is at z = 0.82 m, ours at 0. Its nuts fall 5 cm onto the table at the start; ours start on it.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.kinematics.waypoints import Waypoint, correction_s, miss
from envs.rotations import from_yaw, rotate, wrapped, yaw_of
from envs.scenario import ObjectCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.arm_at_table import above
from envs.tasks.base import Task
from envs.tasks.parameters import interval, parameter
from envs.tasks.robosuite.nuts import (
    NUT_HALF_HEIGHT_M,
    PEG_TOP_M,
    ROUND_NUT,
    SQUARE_NUT,
    TABLE_HEIGHT_M,
    Nut,
)
from envs.tasks.robosuite.scene import UPRIGHT_PITCH_RAD, panda, pedestal
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    finger_gap,
    hand_yaw,
    nearness,
    point_on,
    target_gap,
    wrist_camera,
)

MAX_REACH = 0.6
"""Success takes ``1 - tanh(10 d)`` below this, for the distance d from the hand to the nut's centre."""

REACH_REWARD, GRASP_REWARD, LIFT_REWARD, HOVER_REWARD = 0.1, 0.35, 0.5, 0.7
LIFT_TARGET_M = 0.795 + 0.2 - TABLE_HEIGHT_M
"""robosuite measures the lift from the middle of its table top, 2.5 cm below its surface."""

GRASP_GAP_M = (0.025, 0.04)
"""Gaps between fingers that a handle, 31.75 mm wide, keeps apart."""

GRASP_REACH_M = 0.03
CARRY_HEIGHT_M = PEG_TOP_M + 0.045
"""Height of a nut's centre on its way to the peg."""

RELEASE_HEIGHT_M = 0.035
"""Height at which the expert opens the gripper: the peg guides the nut, and the hand clears the peg."""

LOOK_X_M, LOOK_Y_M, LOOK_Z_M = -0.105, 0.1, 0.19
"""Where the expert stops between two nuts, y towards the next: the wrist's camera sees all its places there.

It is about where the hand starts. Over the pegs no camera shows more of the next handle than a few pixels."""

LOOK_FROM_M, LOOK_TURN_RAD = 0.2, 0.1
"""Horizontal distance from the next nut above which it stops there; standard deviation of its turn there."""

YAW_RANGE_RAD = (-1.9, 3.0)
"""Turns of the hand that the wrist's joint limits leave over nuts and pegs alike."""

_PLACED_ROBOT = panda(-0.56, table_height_m=TABLE_HEIGHT_M)
_CAMERA = dataclasses.replace(FRONT_CAMERA, fovy_deg=30.0)


@dataclass(frozen=True, kw_only=True)
class NutAssembly(Task):
    """Put the square nut on the square peg and the round nut on the round one.

    Attributes:
        variant: ``robosuite`` is the original. ``roboverse`` has the rule of the paper's code: each nut
            within 2 cm of its peg's axis and at most 5 cm above its middle, held or not. (That code has
            the square nut alone: :class:`NutAssemblySquare`.)
        spawn_x_m: Start range of the nuts in x, m.
        spawn_y_m: Start range of the square nut in y, m; the round one has these negated.
        tolerance_xy_m: Horizontal distance along each axis at which a nut is on its peg, m.
        tolerance_z_m: Height below which it is, m; for ``roboverse`` above the peg's middle.
        roboverse_tolerance_m: The variant ``roboverse``: horizontal distance of nut and peg, m.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad.
        approach_noise_m: Standard deviation of where the expert begins to come down on a nut, m.
        detour_m: Lateral offset of the expert's detours, in three of ten motions, m; 0.05 reaches joint
            limits.
    """

    name: ClassVar[str] = "NutAssembly"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the square nut on the square peg and the round nut on the round peg",
        "fit both nuts onto their pegs",
        "place each nut over the peg of its shape",
    )
    max_episode_steps: ClassVar[int] = 400
    nuts: ClassVar[tuple[Nut, ...]] = (SQUARE_NUT, ROUND_NUT)

    variant: Literal["robosuite", "roboverse"] = "robosuite"
    spawn_x_m: tuple[float, float] = interval((-0.115, -0.11), at_least=-0.2, at_most=0.1)
    spawn_y_m: tuple[float, float] = interval((0.11, 0.225), at_least=0.08, at_most=0.3)
    tolerance_xy_m: float = parameter(0.03, above=0.0, at_most=0.1)
    tolerance_z_m: float = parameter(0.05, above=0.0, at_most=0.1)
    roboverse_tolerance_m: float = parameter(0.02, above=0.0, at_most=0.1)
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)
    approach_noise_m: float = parameter(0.01, at_least=0.0, at_most=0.1)
    detour_m: float = parameter(0.03, at_least=0.0, at_most=0.1)

    @property
    @override
    def robot(self) -> RobotCfg:
        return _PLACED_ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        nuts = (
            ObjectCfg(
                name=nut.name,
                mjcf=nut.mjcf,
                mjcf_root="object",
                mjcf_radians=True,
                pos=(self.spawn_x_m[0], nut.side * self.spawn_y_m[0], NUT_HALF_HEIGHT_M),
            )
            for nut in self.nuts
        )
        pegs = (
            ObjectCfg(name=nut.peg, geoms=(nut.peg_geom,), pos=nut.peg_pos, kind="fixed") for nut in self.nuts
        )
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(*nuts, *pegs, pedestal(self.robot)),
            cameras=(_CAMERA, wrist_camera(self.robot)),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(half_size=(0.4, 0.4), height_m=TABLE_HEIGHT_M),
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos = np.tile(np.array(own.default_qpos), (count, 1))
        pos = np.full((count, len(self.nuts), 3), NUT_HALF_HEIGHT_M)
        yaw = np.empty((count, len(self.nuts)))
        for row, rng in enumerate(rngs):
            for column, nut in enumerate(self.nuts):
                pos[row, column, :2] = rng.uniform(*self.spawn_x_m), nut.side * rng.uniform(*self.spawn_y_m)
                yaw[row, column] = rng.uniform(-np.pi, np.pi)
            qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        upright = from_yaw(np.zeros(count))
        objects = {
            nut.name: EntityState.at_rest(pos[:, column], from_yaw(yaw[:, column]))
            for column, nut in enumerate(self.nuts)
        }
        objects |= {nut.peg: EntityState.at_rest(np.array(nut.peg_pos), upright) for nut in self.nuts}
        objects["pedestal"] = EntityState.at_rest(np.array(own.pos), upright)
        return State({own.name: robot}, objects)

    @override
    def success(self, state: State) -> Tensor:
        return torch.stack([self._is_done(state, nut) for nut in self.nuts]).all(0)

    def reward(self, state: State) -> Tensor:
        """Returns robosuite's shaped reward: nuts on their pegs, and reach, grasp, lift, hover of the rest.

        robosuite detects a grasp by contacts; here the gap between the fingers does.
        """
        done = torch.stack([self._is_done(state, nut) for nut in self.nuts], dim=-1)  # (N, nuts)
        reached, grasped, lifted, hovered = (
            torch.stack(stage, dim=-1)
            for stage in zip(*(self._stages(state, n) for n in self.nuts), strict=True)
        )
        reach = REACH_REWARD * reached.where(~done, 0.0).amax(-1)
        grasp = GRASP_REWARD * (grasped & ~done).any(-1)
        lift = (LIFT_REWARD - GRASP_REWARD) * lifted.where(~done, 0.0).amax(-1)
        lift = torch.where(grasp > 0, grasp + lift, 0.0)
        hover = lift + (HOVER_REWARD - LIFT_REWARD) * hovered.where(~done, 0.0).amax(-1)
        staged = torch.stack((reach, grasp, lift, hover)).amax(0)
        return (done.sum(-1) + staged) / len(self.nuts)

    def observe(self, state: State) -> Tensor:
        """Returns every nut's pose, its ways from the hand and to its peg, and the hand, (N, 13 nuts + 3)."""
        hand = ee_pos(state.robots[self.robot.name])
        parts = [hand]
        for nut in self.nuts:
            body, peg = state.objects[nut.name], state.objects[nut.peg]
            parts += [body.pos, body.rot, body.pos - hand, peg.pos - body.pos]
        return torch.cat(parts, dim=-1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        robot = state.robots[self.robot.name]
        hand = ee_pos(robot)[0].numpy()
        away = _way(above(hand, CARRY_HEIGHT_M), hand_yaw(robot), GRASP_OPEN_M, 0.5)
        for nut in self.nuts:
            if not bool(self._is_done(state, nut)[0]):
                body = state.objects[nut.name]
                if bool(self._grasped(robot, body, nut)[0]) and body.pos[0, 2] > 2 * NUT_HALF_HEIGHT_M:
                    return self._place(robot, body, state.objects[nut.peg].pos[0].numpy(), rng)
                start = [] if hand[2] > CARRY_HEIGHT_M - 0.03 else [away]
                return [*start, *self._pick(robot, body, nut, rng)]
        return [away]

    @override
    def foreseen(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way of every nut to its peg, each as if it moved with the hand that took it."""
        robot, ways = state.robots[self.robot.name], list[Waypoint]()
        away = _way(ee_pos(robot)[0].numpy(), hand_yaw(robot), GRASP_OPEN_M, 3.0)
        for nut in self.nuts:
            body, peg = state.objects[nut.name], state.objects[nut.peg].pos[0].numpy()
            way = self._pick(robot, body, nut, rng)
            robot = _moved(robot, way[-1])
            carried = dataclasses.replace(body, pos=ee_pos(robot) + body.pos - _on_handle(body, nut.grip_m))
            placed = self._place(robot, carried, peg, rng)
            robot = _moved(robot, placed[-1])
            ways += [*way, *placed, away]
        return ways

    def _is_done(self, state: State, nut: Nut) -> Tensor:
        pos, peg = state.objects[nut.name].pos, state.objects[nut.peg].pos
        if self.variant == "roboverse":
            off = torch.linalg.vector_norm((pos - peg)[:, :2], dim=-1)
            return (off < self.roboverse_tolerance_m) & (pos[:, 2] < peg[:, 2] + self.tolerance_z_m)
        on_peg = ((pos - peg)[:, :2].abs() < self.tolerance_xy_m).all(-1) & (pos[:, 2] < self.tolerance_z_m)
        return on_peg & (nearness(distance(ee_pos(state.robots[self.robot.name]), pos), 10.0) < MAX_REACH)

    def _stages(self, state: State, nut: Nut) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        robot, body, peg = state.robots[self.robot.name], state.objects[nut.name], state.objects[nut.peg]
        reach = nearness(distance(ee_pos(robot), _on_handle(body, nut.handle_m)), 10.0)
        lift = nearness((LIFT_TARGET_M - body.pos[:, 2]).clamp(min=0.0), 15.0)
        hover = nearness(torch.linalg.vector_norm((peg.pos - body.pos)[:, :2], dim=-1), 10.0)
        return reach, self._grasped(robot, body, nut), lift, hover

    def _grasped(self, robot: EntityState, body: EntityState, nut: Nut) -> Tensor:
        """Returns whether the handle keeps closing fingers apart, (N,)."""
        gap = finger_gap(robot, self.robot)
        round_it = (gap > GRASP_GAP_M[0]) & (gap < GRASP_GAP_M[1])
        if robot.joint_target is not None:
            round_it &= target_gap(robot, self.robot) < gap - 0.001
        return round_it & (distance(ee_pos(robot), _on_handle(body, nut.grip_m)) < GRASP_REACH_M)

    def _look(
        self, robot: EntityState, body: EntityState, nut: Nut, rng: np.random.Generator
    ) -> list[Waypoint]:
        """Returns the way of a hand that comes from a peg to where it sees how the next nut lies.

        A policy learns a grasp from images that show the handle. Without a stop, the hand would turn to the
        handle on its way, and no demonstration would show how to correct a wrong turn.
        """
        hand, place = ee_pos(robot)[0].numpy(), body.pos[0].numpy()
        if np.linalg.norm((hand - place)[:2]) < LOOK_FROM_M:
            return []
        over = np.array([LOOK_X_M, nut.side * LOOK_Y_M, LOOK_Z_M])
        over += rng.normal(0.0, self.approach_noise_m, 3)
        turn = float(rng.normal(0.0, LOOK_TURN_RAD))
        travel, spin = float(np.linalg.norm(over - hand)), abs(turn - hand_yaw(robot))
        return [_way(over, turn, GRASP_OPEN_M, 0.4 + 2.0 * travel + 0.4 * spin, hold_s=0.1)]

    def _pick(
        self, robot: EntityState, body: EntityState, nut: Nut, rng: np.random.Generator
    ) -> list[Waypoint]:
        """Returns the way to take a nut by its handle and to lift it."""
        look = self._look(robot, body, nut, rng) if nut is not self.nuts[0] else []
        handle = _on_handle(body, nut.grip_m)[0].numpy()
        handle[2] = max(handle[2], NUT_HALF_HEIGHT_M)
        turn = _grasp_turn(float(yaw_of(body.rot[0].numpy())))
        # The approach first misses: the next motion demonstrates the correction.
        over_handle = handle + np.array([*rng.normal(0.0, self.approach_noise_m, 2), rng.uniform(0.06, 0.09)])
        turn_s = 0.7 + 0.4 * abs(turn - (look[-1].yaw if look else hand_yaw(robot)))
        return [
            *look,
            *grasp(_way(over_handle, turn, GRASP_OPEN_M, turn_s), handle, rng, self.detour_m),
            _way(np.array([*handle[:2], CARRY_HEIGHT_M]), turn, GRASP_CLOSED_M, 0.7),
        ]

    def _place(
        self, robot: EntityState, body: EntityState, peg: np.ndarray, rng: np.random.Generator
    ) -> list[Waypoint]:
        """Returns the way to bring the nut in the hand over its peg, to lower it and to let go."""
        hand, now = ee_pos(robot)[0].numpy(), hand_yaw(robot)
        turn = float(np.clip(now + wrapped(np.pi - float(yaw_of(body.rot[0].numpy()))), *YAW_RANGE_RAD))
        spin, offset = turn - now, hand - body.pos[0].numpy()
        in_hand = rotate(from_yaw(spin), offset)  # from the nut to the hand, when the hand has turned
        over = np.array([*peg[:2], CARRY_HEIGHT_M]) + in_hand
        low = np.array([*peg[:2], RELEASE_HEIGHT_M]) + in_hand
        # ... and so does the way to the peg.
        aside = rng.normal(0.0, miss(rng, often_m=self.approach_noise_m, seldom_m=self.detour_m), 2)
        near = over + np.array([*aside, rng.uniform(0.0, 0.02)])
        travel = float(np.linalg.norm(near - hand))
        come = _way(over, turn, GRASP_CLOSED_M, max(0.4, correction_s(aside)), hold_s=0.1)
        return [
            _way(near, turn, GRASP_CLOSED_M, 0.4 + 2.0 * travel + 0.4 * abs(spin)),
            *set_down(come, low, down_s=0.8, settle_s=0.1, rise_m=CARRY_HEIGHT_M, rise_s=0.6),
        ]


@dataclass(frozen=True, kw_only=True)
class NutAssemblySquare(NutAssembly):
    """Put the square nut on its peg: robosuite's NutAssemblySquare, without the other nut and peg.

    Attributes:
        variant: As for :class:`NutAssembly`; ``roboverse`` is what the paper's code calls SquareD0.
    """

    name: ClassVar[str] = "NutAssemblySquare"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the square nut on the peg",
        "fit the nut onto the square peg",
        "pick up the nut by its handle and place it over the peg",
    )
    max_episode_steps: ClassVar[int] = 250
    nuts: ClassVar[tuple[Nut, ...]] = (SQUARE_NUT,)


@dataclass(frozen=True, kw_only=True)
class NutAssemblyRound(NutAssembly):
    """Put the round nut on its peg: robosuite's NutAssemblyRound, without the other nut and peg.

    Attributes:
        variant: As for :class:`NutAssembly`.
    """

    name: ClassVar[str] = "NutAssemblyRound"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the round nut on the peg",
        "fit the ring onto the round peg",
        "pick up the round nut by its handle and place it over the peg",
    )
    max_episode_steps: ClassVar[int] = 250
    nuts: ClassVar[tuple[Nut, ...]] = (ROUND_NUT,)


def _on_handle(body: EntityState, along_m: float) -> Tensor:
    """Returns the point of the nut's handle at ``along_m`` from its centre, (N, 3)."""
    return point_on(body, (along_m, 0.0, 0.0))


def _moved(robot: EntityState, way: Waypoint) -> EntityState:
    """Returns a robot whose hand is at a waypoint."""
    hand, yaw = robot.pos.new_tensor(way.pos)[None], np.array([way.yaw + np.pi / 2])
    return dataclasses.replace(robot, ee_pos=hand, ee_rot=torch.from_numpy(from_yaw(yaw)))


def _way(pos: np.ndarray, yaw: float, gripper: float, duration_s: float, hold_s: float = 0.0) -> Waypoint:
    """Returns a waypoint of the hand that points straight down."""
    return Waypoint(
        pos=pos, yaw=yaw, pitch=UPRIGHT_PITCH_RAD, gripper=gripper, duration_s=duration_s, hold_s=hold_s
    )


def _grasp_turn(handle_yaw: float) -> float:
    """Returns the turn of the hand to take a handle that points along ``handle_yaw`` from the nut.

    Its fingers close across the handle. Over the peg the handle has to point to the robot, along -x: with
    the hand at turn 0 if the wrist can come from there, and else turned round by (almost) π.
    """
    low, high = YAW_RANGE_RAD
    turn = float(wrapped(handle_yaw - np.pi))
    return turn if low <= turn <= high else float(np.clip(wrapped(handle_yaw), low, high))
