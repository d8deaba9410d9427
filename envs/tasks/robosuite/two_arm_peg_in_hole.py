"""TwoArmPegInHole, after robosuite 1.5.1 (``environments/manipulation/two_arm_peg_in_hole.py``, MIT).

The left robot carries a peg and the right one a plate with a square hole, both in place of a hand; the plate
is that of ``models/assets/objects/plate-with-hole.xml``. robosuite draws the peg's radius once for each
environment, 15 to 30 mm; here it is an option. The reward is robosuite's shaped one.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, norm, tanh
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.rotations import from_matrix, rotate
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Quat, Rgba, RobotCfg, ScenarioCfg, SiteCfg, Vec3
from envs.state import State
from envs.tasks.arm_at_table import Start, hand_axes, travel_s
from envs.tasks.arms_planner import Phase
from envs.tasks.robosuite.scene import BASE_HEIGHT_M, HOME
from envs.tasks.robosuite.two_arms import TwoArms, opposed
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import Insertion, insertion_way
from envs.tasks.tabletop import DENSITY_KG_M3, FRONT_CAMERA, ee_pos

PEG_HALF_M = 0.13
PLATE_POS: Vec3 = (0.11, 0.0, 0.17)
PLATE_ROT: Quat = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""Pose of the plate at the flange; its normal is the flange's y axis."""

HOLE_POS: Vec3 = (PLATE_POS[0] - 0.1, 0.0, PLATE_POS[2])
"""Middle of the hole, as robosuite's rule has it: 0.1 m along the plate's x axis."""

PLATE: tuple[tuple[Vec3, Vec3], ...] = (
    ((0.0, 0.0, 0.0), (0.06, 0.17, 0.01)),
    ((0.22, 0.0, 0.0), (0.06, 0.17, 0.01)),
    ((0.11, 0.11, 0.0), (0.05, 0.06, 0.01)),
    ((0.11, -0.11, 0.0), (0.05, 0.06, 0.01)),
)
"""Middle and half size of each of its parts."""

_GREEN: Rgba = (0.15, 0.5, 0.15, 1.0)
_WOOD: Rgba = (0.45, 0.12, 0.08, 1.0)
FREE_M = 0.25
"""Distance of the peg's middle from the plate before it goes in."""

EXACT_M, EXACT_RAD = 0.008, 0.04
"""What may lack of peg and hole then."""

MEETING_M = np.array([0.0, 0.15, 1.52])
"""Where the expert holds the hole: high enough for the left wrist to hold the peg level behind it."""

SPREAD_M = 0.03
"""Largest distance from there along each axis."""


def _arm(tool: tuple[GeomCfg, ...], name: str, place: Vec3) -> RobotCfg:
    return replace(
        FRANKA,
        pos=(0.0, 0.0, BASE_HEIGHT_M),
        joints=FRANKA.joints[:7],
        gripper_mjcf=None,
        gripper_root=None,
        gripper_joints=(),
        tool=tool,
        sites=(SiteCfg(name=name, body="tool", pos=place),),
        ee_site=name,
    ).with_home(HOME[:7])


def _plate() -> tuple[GeomCfg, ...]:
    parts = []
    for middle, half in PLATE:
        place = np.array(PLATE_POS) + rotate(np.array(PLATE_ROT), np.array(middle))
        mass = 8.0 * math.prod(half) * DENSITY_KG_M3
        pos = (float(place[0]), float(place[1]), float(place[2]))
        parts.append(GeomCfg(shape="box", size=half, pos=pos, rot=PLATE_ROT, rgba=_WOOD, mass_kg=mass))
    return tuple(parts)


class Fit(NamedTuple):
    """How the peg is to the hole, each (N,).

    Attributes:
        along: Distance of the hole's middle from the peg's along the peg, m.
        off: Distance of the hole's middle from the peg's line, m.
        cosine: Cosine of the angle between the peg and the plate's normal.
    """

    along: Array
    off: Array
    cosine: Array


@dataclass(frozen=True, kw_only=True)
class TwoArmPegInHole(TwoArms):
    """Put a peg into the hole of a plate; each robot carries one of them.

    Attributes:
        peg_radius_m: Radius of the peg.
        most_off_m: Largest distance of the hole's middle from the peg's line.
        along_m: Range of its distance from the peg's middle along the peg.
        least_cosine: Least cosine of the angle between the peg and the plate's normal.
    """

    name: ClassVar[str] = "TwoArmPegInHole"
    instructions: ClassVar[tuple[str, ...]] = (
        "put the peg into the hole of the plate",
        "insert the green peg into the square hole with both arms",
        "bring peg and plate together so that the peg goes through the hole",
    )
    max_episode_steps: ClassVar[int] = 200
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(1.8, 0.0, 1.7), look_at=(0.0, 0.0, 1.2), fovy_deg=50.0
    )

    peg_radius_m: float = 0.0225
    most_off_m: float = 0.06
    along_m: tuple[float, float] = (-0.12, 0.14)
    least_cosine: float = 0.95

    @property
    @override
    def robots(self) -> tuple[RobotCfg, ...]:
        radius = self.peg_radius_m
        peg = GeomCfg(
            shape="cylinder",
            size=(radius, PEG_HALF_M),
            pos=(0.0, 0.0, PEG_HALF_M),
            rgba=_GREEN,
            mass_kg=2.0 * math.pi * radius**2 * PEG_HALF_M * DENSITY_KG_M3,
        )
        left = opposed(_arm((peg,), "peg", (0.0, 0.0, PEG_HALF_M)), 0.6)[0]
        return left, opposed(_arm(_plate(), "hole", HOLE_POS), 0.6)[1]

    @property
    @override
    def robot(self) -> RobotCfg:
        return self.robots[0]

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return replace(super().scenario, table=None)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return self.pedestals

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        del rng
        return {}

    def fit(self, state: State) -> Fit:
        """Returns how the peg is to the hole."""
        left, right = (state.robots[name] for name in _NAMES)
        assert left.ee_rot is not None and right.ee_rot is not None, "a simulator gives every end effector"
        way = ee_pos(right) - ee_pos(left)
        axis = rotate(left.ee_rot, constant((0.0, 0.0, 1.0), way))
        normal = rotate(right.ee_rot, constant((0.0, 1.0, 0.0), way))
        along = (way * axis).sum(-1)
        off = norm(way - along[:, None] * axis)
        return Fit(along, off, abs((normal * axis).sum(-1)))

    @override
    def success(self, state: State) -> Tensor:
        fit, (low, high) = self.fit(state), self.along_m
        inside = (fit.along >= low) & (fit.along <= high) & (fit.off < self.most_off_m)
        return inside & (fit.cosine > self.least_cosine)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns robosuite's: nearness of peg and plate, of the line and along it, and angle; over 5."""
        left, right = (state.robots[name] for name in _NAMES)
        assert right.ee_rot is not None, "a simulator gives every robot's end effector"
        fit, offset = self.fit(state), constant((PLATE_POS[0] - HOLE_POS[0], 0.0, 0.0), ee_pos(right))
        plate = ee_pos(right) + rotate(right.ee_rot, offset)
        near = 1.0 - tanh(norm(plate - ee_pos(left)))
        return (near + 2.0 - tanh(fit.off) - tanh(abs(fit.along)) + fit.cosine) / 5.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the poses of peg and hole, the way between them, and how they fit, (N, 20)."""
        left, right = (state.robots[name] for name in _NAMES)
        fit = self.fit(state)
        measures = concatenate([value[:, None] for value in fit])
        way = ee_pos(right) - ee_pos(left)
        return concatenate((ee_pos(left), left.ee_rot, ee_pos(right), right.ee_rot, way, measures))

    @override
    def phases(self, state: State, rng: np.random.Generator) -> list[Phase]:
        """Returns the way of the hole to where they meet, and the next part of that of the peg into it."""
        left, hole = self.robots[0], self.hand(state, 1)
        place, rot, shown = hole.pos, hole.rot, list[Waypoint]()
        if np.abs(place - MEETING_M).max() > SPREAD_M + 0.02:
            place = MEETING_M + rng.uniform(-SPREAD_M, SPREAD_M, 3)
            rot = hole.nearer(_MET)
            shown = [hole.to(place, rot, 0.0, travel_s(hole.pos, place, 2.0))]
        normal = rotate(rot, np.array([0.0, 1.0, 0.0]))
        into = np.copysign(1.0, normal[1]) * normal  # away from the left robot
        along = rng.uniform(0.06, 0.1)
        # The left hand turns from pointing down to ahead, about the world's x axis alone.
        level = from_matrix(hand_axes(into, np.array([0.0, 0.0, 1.0])))
        where = Insertion(
            goal=Pose(place - along * into, level),
            into=into,
            back_m=FREE_M - along,
            exact_m=EXACT_M,
            exact_rad=EXACT_RAD,
        )
        peg = Held.tool(left, state.robots[left.name])
        return [{left.name: insertion_way(peg, where, rng), hole.name: shown}]


_MET = from_matrix(np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]))
"""Orientation of the plate's flange where peg and hole meet: the hole is ahead of the left robot, along y."""

_NAMES = ("franka_left", "franka_right")
