"""PickChocolatePudding, after LIBERO-object's "pick up the chocolate pudding and place it in the basket".

LIBERO: Liu et al., arXiv 2306.03310, code MIT. The scene is its ``LIBERO_Floor_Manipulation``: everything
stands on the floor, the robot too. There is no table, and levels change the ground and the walls
only. Regions, goal and objects are the task's BDDL file; home posture and base
are ``envs/robots/on_the_ground_panda.py``; the goal's box is ``SiteObject.in_box``.

LIBERO's 50 initial states (``.pruned_init``) were measured for what the BDDL file does not say: its
objects never turn, the arm's joints are N(home, 0.02 rad), the fingers are half closed. Five of its seven
objects, the pudding among them, stand in the middle of their regions in all 50: ``starts="regions"``
samples all of them from their regions instead. Objects start on the floor; LIBERO's begin up to 3.5 cm
under or above it and fall or jump to where they stay.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint, first_miss, grasp_yaw, miss
from envs.robots.franka import FRANKA
from envs.rotations import conjugate, rotate, to_matrix
from envs.scenario import ObjectCfg, RobotCfg, RoomCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.libero_objects import GROCERIES, INIT_STATES, libero_root, read_init_states
from envs.tasks.parameters import parameter
from envs.tasks.skills.from_above import grasp, set_down
from envs.tasks.tabletop import (
    CONTROL_20_HZ,
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    TABLETOP_LOOKS,
    distance,
    ee_pos,
    grips_something,
    nearness,
    wrist_camera,
)

HOME = (0.0, -0.161037389, 0.0, -2.44459747, 0.0, 2.2267522, math.pi / 4, 0.020833, 0.020833)
"""``OnTheGroundPanda.init_qpos``, and the fingers of robosuite's ``PandaGripper.init_qpos``."""

HOME_TILT_RAD = -0.0568
"""Pitch that makes the fingers point straight down: in LIBERO's home posture they lean by that much."""

REGIONS = {
    "chocolate_pudding": ((-0.12, -0.24), 0.025),
    "basket": ((0.0, 0.26), 0.01),
    "orange_juice": ((0.05, -0.1), 0.025),
    "bbq_sauce": ((-0.15, 0.06), 0.025),
    "ketchup": ((0.1, -0.2), 0.025),
    "salad_dressing": ((0.15, 0.03), 0.025),
    "alphabet_soup": ((-0.2, -0.08), 0.025),
}
"""Middle and half size of the BDDL file's regions, m, in the order of the objects."""

CONTAIN_CENTRE_M = (0.0, 0.0, 0.07185)
CONTAIN_HALF_M = (0.06108, 0.06108, 0.06949)
"""The site ``contain_region`` in the basket's frame (``basket.xml``)."""

LIBERO_BOX = ((-0.06108, -0.06108, -0.06949 - 0.01), CONTAIN_HALF_M)
"""``in_box`` lowers the floor of the site's box by 1 cm."""

ROBOVERSE_BOX = ((-0.08, -0.08, -0.11), (0.08, 0.08, 0.05))
"""Box of the paper's code, along the world's axes (snapshot of June 2025)."""

HAND_HALF_M = (0.033, 0.106)
"""Half depth and half width of the hand above the fingers, seen from above."""

HAND_CLEARANCE_M = 0.01
"""Minimum clearance between the hand and the pudding's neighbours."""

CARRY_HEIGHT_M = 0.21
"""Over everything in the scene: the ketchup reaches to 0.146."""

RELEASE_HEIGHT_M = 0.152
"""Over the basket's floor: the pudding is let go just over the rim, above the box that counts."""

_CAMERA = dataclasses.replace(
    FRONT_CAMERA, pos=(1.249, -0.358, 0.75), look_at=(-0.1, 0.0, 0.13), fovy_deg=33.0
)
"""The pose az-016-pol60 of the camera channel: from straight ahead the ketchup hides the pudding."""

_PLACED_ROBOT = dataclasses.replace(FRANKA, pos=(-0.6, 0.0, 0.0)).with_home(HOME)
_PUDDING, _BASKET = "chocolate_pudding", "basket"
_NAMES = tuple(REGIONS)
_DISTRACTORS = _NAMES[2:]
_RADII = {item.name: item.radius_m for item in GROCERIES}


@functools.lru_cache
def _objects(libero_dir: str | None) -> tuple[ObjectCfg, ...]:
    libero = None if libero_dir is None else libero_root(libero_dir)
    objects = (item.config(libero) for item in GROCERIES)
    return tuple(dataclasses.replace(item, pos=(*REGIONS[item.name][0], item.pos[2])) for item in objects)


@functools.lru_cache
def _init_states(libero_dir: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns the joints (50, 9), fingers both positive, and the objects' xy (50, 7, 2) of LIBERO's file."""
    states = read_init_states(libero_root(libero_dir) / INIT_STATES)
    poses = states[:, 10 : 10 + 7 * len(_NAMES)].reshape(len(states), len(_NAMES), 7)
    joints = states[:, 1:10] * np.array([1.0] * 8 + [-1.0])
    return joints, poses[..., :2]


@dataclass(frozen=True, kw_only=True)
class PickChocolatePudding(Task):
    """Pick up the chocolate pudding among six other groceries and put it into the basket.

    It is solved as soon as the middle of the pudding is in the basket: inside the box of LIBERO's goal,
    which turns with the basket (LIBERO's own box grows and shrinks with the basket's yaw and equals this
    one at the yaw in which it starts), or inside that of the paper's code, which does not turn.

    Attributes:
        variant: ``libero`` is the benchmark's goal; ``roboverse`` the larger box of the paper's code.
        starts: ``regions`` samples the BDDL file's regions; ``libero`` samples one of LIBERO's 50 initial
            states (arm and places), which needs ``libero_dir``. These 50 have no splits, so the same
            places come in both splits.
        libero_dir: Folder of a copy of LIBERO, whose meshes, textures and collision boxes are used then.
        region_scale: Size of the regions in which objects start, as a multiple of the BDDL file's.
        min_gap_m: Smallest gap between the circles round two objects, so that samples have no overlap, m.
        goal_margin_m: How much larger than its own the goal's box is, on every side, m.
        qpos_noise_rad: Standard deviation of the arm's joints at the start, rad: robosuite's default; the 50
            initial states have 0.015 to 0.025 by joint.
    """

    name: ClassVar[str] = "PickChocolatePudding"
    instructions: ClassVar[tuple[str, ...]] = (
        "pick up the chocolate pudding and place it in the basket",
        "put the chocolate pudding into the basket",
        "grasp the brown pudding box and drop it into the basket",
        "move the chocolate pudding from the floor to the basket",
    )
    max_episode_steps: ClassVar[int] = 250

    variant: Literal["libero", "roboverse"] = "libero"
    starts: Literal["regions", "libero"] = "regions"
    libero_dir: str | None = None
    region_scale: float = parameter(1.0, at_least=0.0, at_most=1.5)
    min_gap_m: float = parameter(0.008, at_least=0.0, at_most=0.015)
    goal_margin_m: float = parameter(0.0, at_least=-0.04, at_most=0.05)
    qpos_noise_rad: float = parameter(0.02, at_least=0.0, at_most=0.2)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.starts == "libero" and self.libero_dir is None:
            raise ConfigError(
                "starts=libero samples LIBERO's own initial states, which are not part of this project. "
                "Give libero_dir=<folder of a copy of LIBERO>, or take starts=regions."
            )

    @property
    @override
    def robot(self) -> RobotCfg:
        return _PLACED_ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=(self.robot,),
            objects=_objects(self.libero_dir),
            cameras=(_CAMERA, wrist_camera(self.robot)),
            appearance=TABLETOP_LOOKS,
            table=None,
            room=RoomCfg(half_size_m=2.0),  # LIBERO's rear wall is at x = -2
            physics=CONTROL_20_HZ,
        )

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        qpos, places = np.empty((count, len(own.joints))), np.empty((count, len(_NAMES), 2))
        for row, rng in enumerate(rngs):
            if self.starts == "libero":
                joints, xy = _init_states(str(self.libero_dir))
                index = int(rng.integers(len(joints)))
                qpos[row], places[row] = joints[index], xy[index]
            else:
                places[row] = self._draw_places(rng)
                qpos[row] = own.default_qpos
                qpos[row, arm] += rng.normal(0.0, self.qpos_noise_rad, len(arm))
        objects = {}
        for index, item in enumerate(_objects(self.libero_dir)):
            pos = np.column_stack([places[:, index], np.full(count, item.pos[2])])
            objects[item.name] = EntityState.at_rest(pos, np.tile(item.rot, (count, 1)))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), qpos)
        return State({own.name: robot}, objects)

    @override
    def success(self, state: State) -> Tensor:
        low, high = LIBERO_BOX if self.variant == "libero" else ROBOVERSE_BOX
        offset = self._in_goal(state)
        more = self.goal_margin_m
        inside = (offset > offset.new_tensor(low) - more) & (offset < offset.new_tensor(high) + more)
        return inside.all(-1)

    @override
    def reward(self, state: State) -> Tensor:
        robot, pudding = state.robots[self.robot.name], state.objects[_PUDDING].pos
        offset = self._in_goal(state)
        reach = distance(ee_pos(robot), pudding)
        half = offset.new_tensor(CONTAIN_HALF_M[:2])
        over = ((offset[:, :2].abs() < half) & (offset[:, 2:] > 0)).all(-1)
        near = nearness(torch.linalg.vector_norm(offset, dim=-1), 3.0)
        held = (reach < 0.04) & grips_something(robot, 0.02, self.robot) | over
        reached = torch.where(over, torch.ones_like(reach), nearness(reach))
        return 0.25 * (reached + held * (1.0 + near)) + 0.2 * over

    @override
    def observe(self, state: State) -> Tensor:
        """Returns pudding and basket poses, end effector, the ways between them, the others, (N, 38)."""
        pudding, basket = state.objects[_PUDDING], state.objects[_BASKET]
        hand = ee_pos(state.robots[self.robot.name])
        parts = [pudding.pos, pudding.rot, basket.pos, basket.rot]
        parts += [hand, pudding.pos - hand, basket.pos - pudding.pos]
        parts += [state.objects[name].pos for name in _DISTRACTORS]
        return torch.cat(parts, dim=-1)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        basket = state.objects[_BASKET]
        turn = to_matrix(basket.rot[0].numpy())
        if turn[2, 2] < 0.9:  # it fell over: nothing can be put into it
            return []
        target, grip_yaw, shift = self._grasp(state)
        height = max(float(target[2]), 0.012)
        hold, grip = GRASP_OPEN_M, GRASP_CLOSED_M
        goal = basket.pos[0].numpy() + turn @ np.array([0.0, 0.0, RELEASE_HEIGHT_M])
        # Over the basket the pudding's long side is along world x, and its centre over the basket's.
        goal[0] += shift
        # Both ends first miss, above everything: the next motion demonstrates the correction.
        near = target + first_miss(rng, (0.16, 0.20), often_m=0.015, seldom_m=0.05)
        above = target + np.array([0.0, 0.0, 0.07])
        carry = np.array([*(goal[:2] + rng.normal(0.0, miss(rng), 2)), CARRY_HEIGHT_M])
        lifted = np.array([target[0], target[1], CARRY_HEIGHT_M])
        target = np.array([target[0], target[1], height])

        def at(pos: np.ndarray, yaw: float, gripper: float, time_s: float, hold_s: float = 0.0) -> Waypoint:
            turn = {"yaw": yaw, "pitch": HOME_TILT_RAD}
            return Waypoint(pos=pos, gripper=gripper, duration_s=time_s, hold_s=hold_s, **turn)

        over = at(above, grip_yaw, hold, 0.3 + 1.6 * float(np.linalg.norm(above - near)))
        come = at(carry, 0.0, grip, 0.4 + 1.8 * float(np.linalg.norm(carry - lifted)))
        lower_s = 0.3 + 1.6 * float(np.linalg.norm(goal - carry))
        return [
            at(near, grip_yaw, hold, 0.4 + 1.6 * self._gap(state, near)),
            *grasp(over, target, None, down_s=0.35, close_s=0.25),
            at(lifted, grip_yaw, grip, 0.6),
            *set_down(come, goal, down_s=lower_s, settle_s=0.1, open_s=0.2, wait_s=0.8, rise_m=0.0),
        ]

    def _grasp(self, state: State) -> tuple[np.ndarray, float, float]:
        """Returns where to grasp the pudding (3,), the gripper's yaw, and how far before its middle, m.

        The fingers close on the smallest of its level sides. The hand is wider than the pudding: where it
        would hit a neighbour, it grasps off centre, or at a slight angle.
        """
        pudding = state.objects[_PUDDING]
        pos, axes = pudding.pos[0].numpy(), to_matrix(pudding.rot[0].numpy())
        level = [axis for axis in (2, 1) if abs(axes[2, axis]) < 0.4] or [1]
        across, along = axes[:2, level[0]], axes[:2, 0]
        yaw = grasp_yaw(math.atan2(across[1], across[0]) - math.pi / 2, math.pi)
        others = np.array([state.objects[name].pos[0, :2].numpy() for name in _DISTRACTORS])
        radii = np.array([_RADII[name] for name in _DISTRACTORS])
        best = (-math.inf, pos, yaw, 0.0)
        for turn in (0.0, -0.15, 0.15, -0.3, 0.3):
            for shift in (0.0, 0.012, -0.012, 0.02, -0.02):
                place = pos + np.array([*(shift * along), 0.0])
                room = float((_distance_to_hand(others - place[:2], yaw + turn) - radii).min())
                before = math.copysign(shift, shift * float(along @ (math.cos(yaw), math.sin(yaw))))
                if room > best[0]:
                    best = (room, place, yaw + turn, before)
                if best[0] > HAND_CLEARANCE_M:
                    return best[1:]
        return best[1:]

    def _in_goal(self, state: State) -> Tensor:
        """Returns the pudding's place from the middle of the goal's box, along the box's axes, (N, 3)."""
        pudding, basket = state.objects[_PUDDING], state.objects[_BASKET]
        offset = pudding.pos - basket.pos
        if self.variant == "libero":
            offset = rotate(conjugate(basket.rot), offset)
        return offset - offset.new_tensor(CONTAIN_CENTRE_M)

    def _draw_places(self, rng: np.random.Generator) -> np.ndarray:
        """Samples the positions of the objects, (7, 2), again until no two are too near."""
        middles = np.array([middle for middle, _ in REGIONS.values()])
        halves = self.region_scale * np.array([half for _, half in REGIONS.values()])[:, None]
        radii = np.array([_RADII[name] for name in _NAMES])
        least = radii[:, None] + radii + self.min_gap_m
        np.fill_diagonal(least, 0.0)
        while True:
            places = middles + halves * rng.uniform(-1.0, 1.0, middles.shape)
            if (np.linalg.norm(places[:, None] - places, axis=-1) >= least).all():
                return places

    def _gap(self, state: State, target: np.ndarray) -> float:
        return float(np.linalg.norm(ee_pos(state.robots[self.robot.name])[0].numpy() - target))


def _distance_to_hand(points: np.ndarray, yaw: float) -> np.ndarray:
    """Returns the distances (n,) of points (n, 2) from the hand's outline, turned by ``yaw``."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    own = points @ np.array([[cosine, -sine], [sine, cosine]])
    return np.linalg.norm(np.maximum(np.abs(own) - HAND_HALF_M, 0.0), axis=-1)
