"""Door, after robosuite 1.5.1 (``manipulation/door.py``, ``models/assets/objects/door.xml``, MIT).

Sizes, joints and masses are those of the files of its door; ours is made of the same shapes, without their
textures. Its table is square, so that the door stands on it however it is turned. The reward is robosuite's.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, within
from envs.kinematics.waypoints import Waypoint, approach, first_miss, miss
from envs.rotations import from_yaw, multiply, rotate
from envs.scenario import CameraCfg, GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, Quat, Rgba, TableCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, heading, point
from envs.tasks.robosuite.scene import TABLE_HEIGHT_M, RobosuiteTask, down, pedestal
from envs.tasks.skills.joints import along_joint
from envs.tasks.tabletop import FRONT_CAMERA, GRASP_CLOSED_M, distance, ee_pos, nearness

PLACE_M = (-0.2, -0.35, 0.3)
"""``table_offset``, which places are drawn round, and the height of the door's middle above the table."""

HINGE_M = (0.0, -0.335)
"""The hinge in the frame's x and y."""

DOOR_M = 0.255
"""Distance of the panel's middle from the hinge."""

LATCH_M = (-0.175, 0.0, -0.025)
"""The handle's axis in the panel's frame, whose x axis points at the hinge and y axis to the back."""

BAR_M = (0.075, -0.10, 0.0)
"""Middle of the bar in the handle's frame."""

SITE_M = (0.125, -0.10, 0.0)
"""What the reward reaches for (``handle`` site)."""

LATCH_RANGE_RAD = 1.57
HOOK_M = 0.115
"""Distance from the handle's axis along the bar at which the expert pulls."""

TOUCHING_M = 0.026
"""Distance of a fingertip's middle from the bar's when it touches its back: half of each one's width."""

PRESS_M, PRESS_Y_M, PRESS_OFFSET_M = 0.11, -0.107, 0.03
"""Where a fingertip presses the bar: along it, across it, and above its middle."""

PRESSED_RAD, PULLED_RAD, UNLOCKED_RAD, LEAN_RAD = 1.3, 0.36, 0.1, -0.6
"""Turn of the handle that frees the bolt, angle to which the door is drawn then, angle from which the handle
is hooked instead, and lean of the hand away from the panel."""

_SIDE: Quat = (float(np.sqrt(0.5)), 0.0, 0.0, -float(np.sqrt(0.5)))
"""The panel's frame in the door's: turned by -90° about z."""

_LIES: Quat = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
_WHITE: Rgba = (0.9, 0.9, 0.9, 1.0)
_WOOD: Rgba = (0.33, 0.2, 0.12, 1.0)
_BRASS: Rgba = (0.75, 0.62, 0.32, 1.0)


def door(latch: bool) -> ObjectCfg:
    """Returns the door in its frame, with a handle that turns and locks it, or with a fixed one."""
    post = {"shape": "cylinder", "size": (0.03, 0.3), "rgba": _WHITE}
    posts = (GeomCfg(**post, pos=(*HINGE_M, 0.0)), GeomCfg(**post, pos=(0.0, 0.175, 0.0)))
    panel = GeomCfg(shape="box", size=(0.22, 0.02, 0.29), rgba=_WOOD, mass_kg=2.43455)
    hinge = ObjectJointCfg(
        kind="hinge", axis=(0.0, 0.0, 1.0), range=(0.0, 0.4), pos=(DOOR_M, 0.0, 0.0), damping=0.1
    )
    back = 0.0625 if latch else 0.0
    base = GeomCfg(
        shape="cylinder",
        size=(0.025, (0.125 + back) / 2),
        pos=(0.0, (back - 0.125) / 2, 0.0),
        rot=_LIES,
        rgba=_BRASS,
        mass_kg=0.05,
    )
    bar = GeomCfg(shape="box", size=(0.075, 0.015, 0.02), pos=BAR_M, rgba=_BRASS, mass_kg=0.05)
    bolt = (
        GeomCfg(shape="box", size=(0.03125, 0.0125, 0.025), pos=(-0.03125, 0.05, 0.0), rgba=_BRASS),
        GeomCfg(shape="cylinder", size=(0.025, 0.0125), pos=(-0.0625, 0.05, 0.0), rot=_LIES, rgba=_BRASS),
    )
    turn = ObjectJointCfg(
        kind="hinge",
        axis=(0.0, 1.0, 0.0),
        range=(-LATCH_RANGE_RAD, LATCH_RANGE_RAD),
        frictionloss=0.1,
        stiffness=1.0,
    )
    links = (
        LinkCfg(name="hinge", geoms=(panel,), joint=hinge, pos=(0.0, HINGE_M[1] + DOOR_M, 0.0), rot=_SIDE),
        LinkCfg(
            name="latch",
            geoms=(base, bar, *(bolt if latch else ())),
            joint=turn if latch else None,
            parent="hinge",
            pos=LATCH_M,
        ),
    )
    return ObjectCfg(name="door", geoms=posts, links=links, pos=PLACE_M, kind="fixed")


@dataclass(frozen=True, kw_only=True)
class Door(RobosuiteTask):
    """Turn the handle of a door and pull the door open.

    Attributes:
        latch: Whether the handle has to be turned first, as in robosuite by default.
        spawn_x_m: Range of the door along x, from the middle of the table.
        spawn_y_m: Likewise along y.
        yaw_rad: Range of its turn.
        open_rad: Angle of the hinge that is a success.
    """

    name: ClassVar[str] = "Door"
    instructions: ClassVar[tuple[str, ...]] = (
        "open the door",
        "turn the door handle and pull the door open",
        "open the door by its handle",
    )
    max_episode_steps: ClassVar[int] = 250
    table: ClassVar[TableCfg] = TableCfg(
        pos=(-0.2, -0.45, 0.0), half_size=(0.36, 0.36), height_m=TABLE_HEIGHT_M
    )
    camera: ClassVar[CameraCfg] = dataclasses.replace(FRONT_CAMERA, look_at=(-0.2, -0.15, 0.3), fovy_deg=40.0)

    latch: bool = True
    spawn_x_m: tuple[float, float] = (0.07, 0.09)
    spawn_y_m: tuple[float, float] = (-0.01, 0.01)
    yaw_rad: tuple[float, float] = (-np.pi / 2 - 0.25, -np.pi / 2)
    open_rad: float = 0.3

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (door(self.latch), pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        x, y, z = PLACE_M
        place = (x + rng.uniform(*self.spawn_x_m), y + rng.uniform(*self.spawn_y_m), z)
        return {"door": Start(place, rng.uniform(*self.yaw_rad), (0.0, 0.0) if self.latch else (0.0,))}

    @override
    def success(self, state: State) -> Tensor:
        return state.objects["door"].joint_pos[:, 0] > self.open_rad

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: 0.25 for a hand at the handle, and 0.25 for the turn of one with a latch."""
        reach = 0.25 * nearness(distance(ee_pos(self.arm(state)), self._handle(state)), 10.0)
        if not self.latch:
            return reach
        turn = abs(state.objects["door"].joint_pos[:, 1]) / LATCH_RANGE_RAD
        return reach + 0.25 * within(turn, 0.0, 1.0)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the door's pose and joints, the handle, the end effector, the way between them, (N, 17)."""
        item, hand, handle = state.objects["door"], ee_pos(self.arm(state)), self._handle(state)
        return concatenate((item.pos, item.rot, item.joint_pos, handle, hand, handle - hand))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item = state.objects["door"]
        now = float(item.joint_pos[0, 0])
        turn = heading(item)
        if self.latch and now < UNLOCKED_RAD:
            return self._unlock(state, rng)
        along, shut = HOOK_M + rng.uniform(-0.01, 0.01), GRASP_CLOSED_M

        def at(angle: float, back_m: float, up_m: float, duration_s: float, side_m: float = 0.0) -> Waypoint:
            """Fingers that point down, so far behind the bar of a door that is open by ``angle``."""
            local = np.array(LATCH_M) + np.array([along + side_m, BAR_M[1] + back_m, up_m])
            pos = self._in_world(state, local, angle)
            return down(pos, turn + angle + np.pi, shut, duration_s)

        free, pull = TOUCHING_M + 0.007, TOUCHING_M - 0.004
        # The approach first misses: the next motion demonstrates the correction.
        side, off = rng.normal(0.0, miss(rng, often_m=0.01, seldom_m=0.025)), rng.normal(0.0, 0.006)
        pace = rng.uniform(0.9, 1.1)
        return [
            *self.rise(state, 0.4),
            *approach(at(now, free + off, 0.12, 1.2, side), rng, 0.01),
            at(now, free, 0.12, 0.4),
            at(now, free, 0.0, 0.6),
            *along_joint(lambda angle: at(angle, pull, 0.0, 0.4 * pace), now, self.open_rad + 0.08, 4),
        ]

    def _unlock(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way to press the handle down by its bar, and to draw the door with it by friction."""
        item, shut = state.objects["door"], GRASP_CLOSED_M
        turn, now = heading(item) + np.pi / 2, float(item.joint_pos[0, 0])
        reach, pace = PRESS_M + rng.uniform(-0.005, 0.005), rng.uniform(0.9, 1.1)

        def at(
            handle: float, angle: float, duration_s: float, away_m: float = 0.0, hold_s: float = 0.0
        ) -> Waypoint:
            """A fingertip on the bar of a handle turned by ``handle``, or ``away_m`` from it."""
            cos, sin = np.cos(handle), np.sin(handle)
            off = PRESS_OFFSET_M + away_m
            local = np.array(LATCH_M) + np.array(
                [reach * cos + off * sin, PRESS_Y_M, off * cos - reach * sin]
            )
            pos = self._in_world(state, local, angle)
            return dataclasses.replace(down(pos, turn + angle, shut, duration_s, hold_s), roll=LEAN_RAD)

        noise = first_miss(rng, (0.0, 0.02), seldom_m=0.025)
        over = at(0.0, now, 1.2, 0.1)
        return [
            *self.rise(state, 0.4),
            *approach(dataclasses.replace(over, pos=over.pos + noise), rng, 0.01),
            at(0.0, now, 0.4, 0.04),
            at(0.0, now, 0.4),
            *along_joint(lambda handle: at(handle, now, 0.3 * pace), 0.0, PRESSED_RAD, 5),
            *along_joint(lambda angle: at(PRESSED_RAD, angle, 0.5 * pace), now, PULLED_RAD, 7),
        ]

    def _in_world(self, state: State, local: np.ndarray, angle: float) -> np.ndarray:
        """Returns a point (3,) of the panel's frame when the door is open by an angle, in the world, m."""
        item = state.objects["door"]
        from_hinge = local - np.array([DOOR_M, 0.0, 0.0])
        turned = rotate(multiply(np.array(_SIDE), from_yaw(angle)), from_hinge) + np.array([*HINGE_M, 0.0])
        return point(item) + rotate(item.rot[0].numpy(), turned)

    def _handle(self, state: State) -> Array:
        """Returns the handle's site, m, (N, 3)."""
        item = state.objects["door"]
        site, joints = constant(SITE_M, item.pos), item.joint_pos
        if self.latch:  # turns about the panel's y axis
            cos, sin = _cos_sin(joints[:, 1:2])
            x, z = site[0] * cos + site[2] * sin, site[2] * cos - site[0] * sin
            site = concatenate((x, 0.0 * x + site[1], z))
        from_hinge = site + constant((LATCH_M[0] - DOOR_M, LATCH_M[1], LATCH_M[2]), item.pos)
        swing = multiply(constant(_SIDE, item.pos), from_yaw(joints[:, 0]))
        return item.pos + rotate(item.rot, rotate(swing, from_hinge) + constant((*HINGE_M, 0.0), item.pos))


def _cos_sin(angles: Array) -> tuple[Array, Array]:
    if isinstance(angles, np.ndarray):
        return np.cos(angles), np.sin(angles)
    return angles.cos(), angles.sin()
