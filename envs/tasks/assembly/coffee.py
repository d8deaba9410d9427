"""Coffee, after MimicGen (arXiv:2310.17596): a pod goes into the holder of a machine, whose lid is then shut.

Holder and pod have about MimicGen's sizes; the rest of the machine is ours, and stands fast. MimicGen's rule:
the lid is open by less than 15°, the pod is off the holder's axis by no more than the difference of their
radii, and it is between the holder's bottom and the lid.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.rotations import rotate
from envs.scenario import CameraCfg, GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, Quat, Rgba, Vec3
from envs.state import State
from envs.tasks.arm_at_table import heading, point
from envs.tasks.assembly.ranges import Range, RangedTask, Ranges
from envs.tasks.robosuite.scene import pedestal
from envs.tasks.skills.from_above import take, way_across
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import DOWN, Insertion, insertion_way
from envs.tasks.skills.joints import along_joint
from envs.tasks.skills.moves import Hand, at_height
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    distance,
    ee_pos,
    flat_distance,
    is_held,
    nearness,
    point_on,
)

POD_RADIUS_M, POD_HALF_M = 0.02, 0.012
HOLDER_INNER_M, HOLDER_OUTER_M, HOLDER_HALF_M = 0.0255, 0.0295, 0.014
HOLDER_M: Vec3 = (0.03, 0.0, 0.106)
"""Middle of the holder in the machine's frame, whose x axis points to its front."""

HINGE_M: Vec3 = (-0.012, 0.0, 0.128)
LID_M: Vec3 = (0.036, 0.03, 0.005)
LID_AHEAD_M = 0.042
"""The lid's hinge, half sizes, and distance of its middle from the hinge."""

OPEN_RAD = 2.0 * math.pi / 3.0
SHUT_RAD = math.radians(15.0)
GRIP_M = 0.010
"""Height of the grip site above the pod's middle: the pod is let go of with fingers above the holder."""

RELEASE_M = 0.123
"""Height of the pod's middle there."""

REACH_M, AWAY_M = 0.065, 0.016
"""Where fingers push the lid: distance from the hinge, and of their middle from the lid's."""

CARRY_M_S = 0.33
"""Mean speed of the held pod, which is round: it slips out of a faster hand as that stops."""

TRAVEL_M, OVER_M = 0.3, 0.09
GRASP_REACH_M = 0.03
_SIDES = 12
_BODY: Rgba = (0.2, 0.2, 0.22, 1.0)
_SILVER: Rgba = (0.75, 0.76, 0.78, 1.0)
_LID: Rgba = (0.6, 0.12, 0.1, 1.0)
_POD: Rgba = (0.45, 0.27, 0.12, 1.0)


def machine() -> ObjectCfg:
    """Returns the machine with its lid."""
    x, _, z = HOLDER_M
    geoms = [
        GeomCfg(shape="box", size=(0.075, 0.055, 0.008), pos=(0.0, 0.0, 0.008), rgba=_SILVER),
        GeomCfg(shape="box", size=(0.03, 0.055, 0.056), pos=(-0.045, 0.0, 0.072), rgba=_BODY),
        GeomCfg(shape="box", size=(0.01, 0.02, 0.012), pos=(-0.008, 0.0, 0.1), rgba=_BODY),
        GeomCfg(
            shape="cylinder",
            size=(HOLDER_INNER_M, 0.002),
            pos=(x, 0.0, z - HOLDER_HALF_M + 0.002),
            rgba=_SILVER,
        ),
    ]
    middle, wall = (HOLDER_INNER_M + HOLDER_OUTER_M) / 2, (HOLDER_OUTER_M - HOLDER_INNER_M) / 2
    side = middle * math.tan(math.pi / _SIDES) + 5e-4
    for index in range(_SIDES):
        angle = 2.0 * math.pi * index / _SIDES
        rot: Quat = (math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0))
        pos = (x + middle * math.cos(angle), middle * math.sin(angle), z)
        geoms.append(GeomCfg(shape="box", size=(wall, side, HOLDER_HALF_M), pos=pos, rot=rot, rgba=_SILVER))
    joint = ObjectJointCfg(
        kind="hinge", axis=(0.0, -1.0, 0.0), range=(0.0, OPEN_RAD), damping=0.005, frictionloss=0.002
    )
    plate = GeomCfg(shape="box", size=LID_M, pos=(LID_AHEAD_M, 0.0, 0.0), rgba=_LID, mass_kg=0.03)
    lid = LinkCfg(name="lid", geoms=(plate,), joint=joint, pos=HINGE_M)
    return ObjectCfg(name="machine", geoms=tuple(geoms), links=(lid,), kind="fixed")


def pod() -> ObjectCfg:
    """Returns the pod."""
    mass = 2.0 * math.pi * POD_RADIUS_M**2 * POD_HALF_M * 500.0
    geom = GeomCfg(shape="cylinder", size=(POD_RADIUS_M, POD_HALF_M), rgba=_POD, mass_kg=mass)
    return ObjectCfg(name="pod", geoms=(geom,), pos=(0.0, 0.0, POD_HALF_M))


@dataclass(frozen=True, kw_only=True)
class Coffee(RangedTask):
    """Put the pod into the machine and shut its lid."""

    name: ClassVar[str] = "Coffee"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the coffee pod in the machine and close the lid",
        "insert the pod into its holder and shut the coffee machine",
        "load the coffee machine with the pod",
    )
    max_episode_steps: ClassVar[int] = 400
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(-0.03, 0.02, 0.1), fovy_deg=32.0)
    radii_m: ClassVar[dict[str, float]] = {"machine": 0.1, "pod": 0.03}
    joints: ClassVar[dict[str, tuple[float, ...]]] = {"machine": (OPEN_RAD,)}
    # MimicGen's machine has its front along positive y of its frame.
    ranges: ClassVar[Ranges] = {
        "D0": {
            "machine": Range((0.0, 0.0), (-0.1, -0.1), (np.pi / 3, np.pi / 3)),
            "pod": Range((-0.13, -0.07), (0.17, 0.23)),
        },
        "D1": {
            "machine": Range((0.05, 0.15), (-0.2, -0.1), (np.pi / 3, 5 * np.pi / 6)),
            "pod": Range((-0.2, 0.05), (0.17, 0.3)),
        },
        "D2": {
            "machine": Range((-0.05, 0.05), (0.1, 0.2), (7 * np.pi / 6, 5 * np.pi / 3)),
            "pod": Range((-0.2, 0.05), (-0.3, -0.17)),
        },
    }

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (machine(), pod(), pedestal(self.robot))

    def holder(self, state: State) -> Array:
        """Returns the middle of the holder, m, (N, 3)."""
        return point_on(state.objects["machine"], HOLDER_M)

    def pod_inside(self, state: State) -> Array:
        """Returns whether the pod is in the holder, (N,)."""
        item, holder = state.objects["pod"].pos, self.holder(state)
        near = flat_distance(item, holder) <= HOLDER_OUTER_M - POD_RADIUS_M
        low = item[:, 2] - POD_HALF_M >= holder[:, 2] - HOLDER_HALF_M
        under = HINGE_M[2] - LID_M[2] - HOLDER_M[2]
        return near & low & (item[:, 2] + POD_HALF_M <= holder[:, 2] + under)

    @override
    def success(self, state: State) -> Tensor:
        return self.pod_inside(state) & (state.objects["machine"].joint_pos[:, 0] < SHUT_RAD)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.2 each for a near hand, a held pod and its way; then 0.6, and up to 0.3 for the lid."""
        item, hand = state.objects["pod"].pos, ee_pos(self.arm(state))
        held = is_held(self.arm(state), item, GRASP_REACH_M, 2 * POD_RADIUS_M, cfg=self.robot)
        placed = nearness(distance(item, self.holder(state)))
        inside = self.pod_inside(state)
        shut = 1.0 - state.objects["machine"].joint_pos[:, 0] / OPEN_RAD
        outside = 0.2 * (nearness(distance(hand, item)) + held + placed)
        return outside * ~inside + (0.6 + 0.3 * shut.clip(0.0, 1.0)) * inside

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of pod and machine, the lid, end effector, and ways between them, (N, 24)."""
        item, stand, hand = state.objects["pod"], state.objects["machine"], ee_pos(self.arm(state))
        ways = (item.pos - hand, self.holder(state) - item.pos)
        return concatenate((item.pos, item.rot, stand.pos, stand.rot, stand.joint_pos, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        if bool(self.pod_inside(state)[0]):
            return self._shut(state, rng)
        item, turn = state.objects["pod"], grasp_yaw(heading(state.objects["machine"]), np.pi)
        place = point(item)
        held = is_held(self.arm(state), item.pos, GRASP_REACH_M, 2 * POD_RADIUS_M, cfg=self.robot)
        if bool(held[0]) and place[2] > 0.05:
            goal = self.holder(state)[0].numpy().copy()
            goal[2] += RELEASE_M - HOLDER_M[2]
            where = Insertion(
                goal=Pose.level(goal, heading(item)),  # it is round
                into=DOWN,
                back_m=OVER_M,
                exact_m=0.002,
                exact_rad=0.1,
                carry_m_s=CARRY_M_S,
                opening_m=0.03,
            )
            return insertion_way(Held.of(self, state, "pod"), where, rng)
        hand = Hand.of(self, state, rng)
        # Fingers close across the machine's front: the open lid is behind the hand.
        return take(hand, place + np.array([0.0, 0.0, GRIP_M]), turn, TRAVEL_M, rng)

    @override
    def foreseen(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the grasp, the place over the holder, and the push of the lid."""
        way = self.expert(state, rng)
        over = replace(way[-1], pos=self.holder(state)[0].numpy() + np.array([0.0, 0.0, OVER_M]))
        return [*way, over, *self._shut(state, rng)]

    def _shut(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that pushes the lid over from behind, and down."""
        hand, stand, shut = Hand.of(self, state, rng), state.objects["machine"], GRASP_CLOSED_M
        turn, now = grasp_yaw(heading(stand), np.pi), float(stand.joint_pos[0, 0])

        def at(ahead: float, up: float) -> np.ndarray:
            local = constant((ahead, 0.0, up), stand.pos)
            return (stand.pos + rotate(stand.rot, local))[0].numpy().copy()

        def pushing(angle: float) -> Waypoint:
            cosine, sine = math.cos(angle), math.sin(angle)
            x, _, z = HINGE_M
            pos = at(x + REACH_M * cosine - AWAY_M * sine, z + REACH_M * sine + AWAY_M * cosine)
            pos[2] -= 0.0 if angle else 0.004  # at the end it presses
            return replace(hand.to(pos, turn, shut), duration_s=0.25 * pace)

        pace, begin = rng.uniform(0.9, 1.1), min(now, OPEN_RAD - 0.1)
        pushes = [pushing(begin), *along_joint(pushing, begin, 0.0, 6)]
        behind, end = pushes[0].pos + at(-0.03, 0.0) - at(0.0, 0.0), hand.after(pushes)
        way = way_across(hand, at_height(behind, TRAVEL_M), turn, shut, TRAVEL_M)
        high = replace(hand, pos=at_height(behind, TRAVEL_M))
        way.append(high.to(behind, turn, shut))
        leaves = end.to(end.pos, turn, shut), end.to(at_height(end.pos, TRAVEL_M), turn, shut)
        return [*way, *pushes, *leaves]
