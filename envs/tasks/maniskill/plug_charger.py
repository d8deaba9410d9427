"""PlugCharger, after ManiSkill 3 (``tabletop/plug_charger.py``).

ManiSkill has no dense reward for it; ours is reach, grasp, line up, plug in. Its receptacle floats 5 cm above
the table; ours has a stand, which nothing touches.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, norm
from envs.kinematics.waypoints import Waypoint, approach, first_miss
from envs.rotations import conjugate, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, above, heading, point, way
from envs.tasks.maniskill.parts import WHITE, box
from envs.tasks.skills.from_above import grasp
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import Insertion, insertion_way
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    distance,
    ee_pos,
    hand_yaw,
    is_held,
    nearness,
    point_on,
)

HEIGHT_M = 0.1
"""Height of the receptacle's middle."""

GRASP_REACH_M = 0.02
TIP_RAD = -0.35
"""Tip of the expert's fingers, which keeps the palm off the receptacle."""

OPEN_M = 0.008
"""Room between the charger and each open finger, which keeps them off the receptacle."""

READY_M, EXACT_M, EXACT_RAD = 0.03, 2.5e-4, 0.01
"""Distance from which the expert plugs in, and errors of the charger's pose at which it begins to."""

_GREY: Rgba = (0.3, 0.3, 0.32, 1.0)
_GOLD: Rgba = (0.7, 0.45, 0.04, 1.0)


@dataclass(frozen=True, kw_only=True)
class PlugCharger(ArmAtTable):
    """Take a charger and put its two pins into the receptacle.

    Attributes:
        base_half_size_m: Half extents of the charger's body.
        pin_half_size_m: Half extents of each pin.
        pin_gap_m: Distance of each pin from the middle.
        clearance_m: How much wider than the pins the holes are, to each side.
        receptacle_half_size_m: Half extents of the receptacle.
        charger_low_m: Least x and y of the charger's start.
        charger_high_m: Largest x and y of the charger's start.
        charger_turn_rad: Largest turn of the charger from pointing along x.
        receptacle_low_m: Least x and y of the receptacle.
        receptacle_high_m: Largest x and y of the receptacle.
        receptacle_turn_rad: Largest turn of the receptacle from facing the robot.
        tolerance_m: Largest distance of the charger from its place.
        tolerance_rad: Largest angle of the charger from its orientation there.
    """

    name: ClassVar[str] = "PlugCharger"
    instructions: ClassVar[tuple[str, ...]] = (
        "plug the charger into the receptacle",
        "pick up the white charger and insert its pins into the socket",
        "put the plug into the wall socket",
    )
    max_episode_steps: ClassVar[int] = 300
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(0.1, -1.1, 0.6), look_at=(0.0, 0.0, 0.06), fovy_deg=28.0
    )

    base_half_size_m: tuple[float, float, float] = (0.02, 0.015, 0.012)
    pin_half_size_m: tuple[float, float, float] = (0.008, 0.00075, 0.0032)
    pin_gap_m: float = 0.007
    clearance_m: float = 0.0005
    receptacle_half_size_m: tuple[float, float, float] = (0.01, 0.05, 0.05)
    charger_low_m: tuple[float, float] = (-0.1, -0.2)
    charger_high_m: tuple[float, float] = (-0.026, 0.2)
    charger_turn_rad: float = np.pi / 3
    receptacle_low_m: tuple[float, float] = (0.01, -0.1)
    receptacle_high_m: tuple[float, float] = (0.1, 0.1)
    receptacle_turn_rad: float = np.pi / 8
    tolerance_m: float = 0.005
    tolerance_rad: float = 0.2

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        x, y, z = self.base_half_size_m
        pin = self.pin_half_size_m
        charger = (
            box((x, y, z), WHITE, (-x, 0.0, 0.0)),
            *(box(pin, _GOLD, (pin[0], sign * self.pin_gap_m, 0.0)) for sign in (-1, 1)),
        )
        return (
            ObjectCfg(name="charger", geoms=charger, pos=(-0.1, 0.0, z)),
            ObjectCfg(name="receptacle", geoms=self._receptacle, pos=(0.05, 0.0, HEIGHT_M), kind="fixed"),
        )

    @property
    def _receptacle(self) -> tuple[GeomCfg, ...]:
        """Beams round the two holes, which are along x, and between them; a stand."""
        deep, wide, high = self.receptacle_half_size_m
        hole_y, hole_z = (half + self.clearance_m for half in self.pin_half_size_m[1:])
        inner, outer = self.pin_gap_m - hole_y, self.pin_gap_m + hole_y
        spans = (
            ((-wide, wide), (hole_z, high)),
            ((-wide, wide), (-high, -hole_z)),
            ((outer, wide), (-hole_z, hole_z)),
            ((-wide, -outer), (-hole_z, hole_z)),
            ((-inner, inner), (-hole_z, hole_z)),
        )
        beams = tuple(
            GeomCfg(
                shape="box",
                size=(deep, (y1 - y0) / 2, (z1 - z0) / 2),
                pos=(-deep, (y0 + y1) / 2, (z0 + z1) / 2),
                rgba=WHITE,
            )
            for (y0, y1), (z0, z1) in spans
        )
        leg = (HEIGHT_M - high) / 2
        place = (-1.5 * deep, 0.0, -high - leg)
        stand = GeomCfg(shape="box", size=(deep / 2, wide / 2, leg), pos=place, rgba=_GREY, collides=False)
        return (*beams, stand)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        charger_yaw = rng.uniform(-self.charger_turn_rad, self.charger_turn_rad)
        yaw = np.pi + rng.uniform(-self.receptacle_turn_rad, self.receptacle_turn_rad)
        charger = rng.uniform(self.charger_low_m, self.charger_high_m)
        receptacle = rng.uniform(self.receptacle_low_m, self.receptacle_high_m)
        return {
            "charger": Start((*charger, self.base_half_size_m[2]), charger_yaw),
            "receptacle": Start((*receptacle, HEIGHT_M), yaw),
        }

    @override
    def success(self, state: State) -> Tensor:
        left, aligned = self._left(state)
        return (norm(left) <= self.tolerance_m) & (aligned >= np.cos(self.tolerance_rad / 2))

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.2 each for reach and grasp; held, 0.3 for lining up and 0.25 for plugging in."""
        robot = self.arm(state)
        left, aligned = self._left(state)
        reach = nearness(distance(ee_pos(robot), self._body(state)))
        held = is_held(robot, self._body(state), GRASP_REACH_M, 2 * self.base_half_size_m[1], cfg=self.robot)
        lined = nearness(norm(left[:, 1:])) * aligned**2
        return 0.2 * reach + held * (0.2 + 0.3 * lined + 0.25 * nearness(norm(left)))

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of charger and receptacle, end effector, ways to body and place, (N, 23)."""
        item, goal = state.objects["charger"], state.objects["receptacle"]
        hand = ee_pos(self.arm(state))
        ways = (self._body(state) - hand, self._left(state)[0])
        return concatenate((item.pos, item.rot, goal.pos, goal.rot, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        item, body = state.objects["charger"], self._body(state)
        held = is_held(self.arm(state), body, GRASP_REACH_M, 2 * self.base_half_size_m[1], cfg=self.robot)
        if bool(held[0]) and item.pos[0, 2] > 3 * self.base_half_size_m[2]:
            receptacle = state.objects["receptacle"]
            goal = Pose.level(point(receptacle), heading(receptacle) - np.pi)
            where = Insertion(
                goal=goal,
                into=goal.ahead,
                back_m=2 * self.pin_half_size_m[0] + READY_M,
                exact_m=EXACT_M,
                exact_rad=EXACT_RAD,
                speed_m_s=0.04,
            )
            return insertion_way(Held.of(self, state, "charger"), where, rng)
        start, turn = body[0].numpy().copy(), heading(item)
        start[2] = self.base_half_size_m[2] + 0.004
        noise = first_miss(rng, (0.19, 0.21))
        lift = np.array([*start[:2], HEIGHT_M + rng.uniform(0.01, 0.03)])
        hold = self.base_half_size_m[1] + OPEN_M
        turn_s = 0.6 + 0.4 * abs(turn - hand_yaw(self.arm(state)))
        over = way(above(start, 0.04), turn, hold, 0.6, pitch=TIP_RAD)
        return [
            *self.rise(state, 0.16),
            *approach(way(start + noise, turn, hold, turn_s, pitch=TIP_RAD), rng, 0.02),
            *grasp(over, start, None, down_s=0.4, hold_s=0.1),
            way(lift, turn, GRASP_CLOSED_M, 0.7, 0.1, TIP_RAD),
        ]

    def _body(self, state: State) -> Array:
        """Returns the middle of the charger's body, (N, 3), m."""
        return point_on(state.objects["charger"], (-self.base_half_size_m[0], 0.0, 0.0))

    def _left(self, state: State) -> tuple[Array, Array]:
        """Returns the charger's place in the receptacle's frame, (N, 3), m, and the cosine of half its turn.

        The charger's place is the receptacle's, turned by π about z.
        """
        item, goal = state.objects["charger"], state.objects["receptacle"]
        p, q = goal.rot, item.rot
        # The scalar part of (goal · half a turn)⁻¹ · charger.
        half = -p[:, 3] * q[:, 0] + p[:, 2] * q[:, 1] - p[:, 1] * q[:, 2] + p[:, 0] * q[:, 3]
        return rotate(conjugate(p), item.pos - goal.pos), abs(half)
