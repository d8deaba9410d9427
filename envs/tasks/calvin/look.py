"""What CALVIN's expert sees of one state, and how its hand comes from one place of the table to another."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from envs.rotations import to_matrix
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.arm_at_table import hand_axes
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin.scene import DESK_M, HALF_WIDTH_M, TABLE, half_length
from envs.tasks.calvin_table import LAYOUTS, SCALE, TableLayout
from envs.tasks.skills.path import Path
from envs.tasks.tabletop import GRASP_OPEN_M, ee_pos, finger_gap, target_gap

LANE_Y_M, LANE_Z_M = -0.15, 0.58
"""Where the hand passes along the table, clear of the door's handle and of stacked blocks."""

DOOR_M = 0.35 * SCALE
"""Width of the sliding door."""

DRAWER_MOUTH_M = -0.18
"""The desk's edge, y; the drawer comes out below it."""

HELD_WITHIN_M = 0.05
"""Largest distance of a held block from the point between the fingertips."""

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A block in one state.

    Attributes:
        colour: Its colour.
        pos: Its middle, m, (3,).
        rot: Its orientation, (3, 3).
        half: Half its sizes, m, (3,).
        touches: Bits of :mod:`envs.tasks.calvin.memory`.
        began: The same at the start of the episode.
    """

    colour: str
    pos: np.ndarray
    rot: np.ndarray
    half: np.ndarray
    touches: int
    began: int

    def level_axes(self) -> list[tuple[np.ndarray, float, float]]:
        """Returns the two axes that lie, (3,), half the size along each and half that along the other."""
        standing = int(np.abs(self.rot[2]).argmax())
        one, two = (axis for axis in range(3) if axis != standing)
        return [
            (self.rot[:, a], float(self.half[a]), float(self.half[b])) for a, b in ((one, two), (two, one))
        ]

    @property
    def top_m(self) -> float:
        """Height of its highest point, m."""
        return float(self.pos[2] + np.abs(self.rot[2]) @ self.half)

    @property
    def radius_m(self) -> float:
        """Radius of the circle round it, seen from above, m."""
        return float(np.linalg.norm(np.sort(self.half)[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One state.

    Attributes:
        layout: Where the table's parts are.
        robot: The robot.
        hand_pos: Point between the fingertips, m, (3,).
        hand_rot: Orientation of the hand, (3, 3).
        joints: Door, drawer, button, switch, m, (4,).
        blocks: Colour to block.
        held: Colour of the block in the hand, or None.
        pace: Factor of every duration.
        luck: From 0 to 1, drawn for each plan: how a grasp that may fail is varied.
    """

    layout: TableLayout
    robot: RobotCfg
    hand_pos: np.ndarray
    hand_rot: np.ndarray
    joints: np.ndarray
    blocks: dict[str, Block]
    held: str | None
    pace: float
    luck: float

    def door_m(self) -> tuple[float, float]:
        """Returns the ends of the sliding door along x, m."""
        left = self.layout.slide * SCALE - float(self.joints[0])
        return left, left + DOOR_M

    def others(self, colour: str) -> list[Block]:
        """Returns the other blocks."""
        return [block for name, block in self.blocks.items() if name != colour]


def look_at(scene: str, robot: RobotCfg, state: State, pace: float, luck: float = 0.0) -> Look:
    """Returns what is seen of a state of one row; where it has no contact, contacts are the start's."""
    arm = state.robots[robot.name]
    assert arm.ee_rot is not None, "a simulator gives every robot's end effector"
    hand = ee_pos(arm)[0].numpy()
    began = {colour: int(memory.start_touches(state, colour)[0]) for colour in BLOCKS}
    touches = {colour: int(memory.touches(state, colour)[0]) for colour in BLOCKS}
    if not any(touches.values()):  # mujoco_warp reports no contact before the first step
        touches = began
    blocks = {}
    for colour in BLOCKS:
        entity = state.objects[f"block_{colour}"]
        blocks[colour] = Block(
            colour,
            entity.pos[0].numpy(),
            to_matrix(entity.rot[0].numpy()),
            np.array([half_length(scene, colour), HALF_WIDTH_M, HALF_WIDTH_M]),
            touches[colour],
            began[colour],
        )
    squeezes = bool((target_gap(arm, robot) < finger_gap(arm, robot) - 0.004)[0])
    near = [
        colour
        for colour, block in blocks.items()
        if squeezes and block.touches & memory.ROBOT_BIT and np.linalg.norm(block.pos - hand) < HELD_WITHIN_M
    ]
    return Look(
        layout=LAYOUTS[scene],
        robot=robot,
        hand_pos=hand,
        hand_rot=to_matrix(arm.ee_rot[0].numpy()),
        joints=state.objects[TABLE].joint_pos[0].numpy(),
        blocks=blocks,
        held=near[0] if near else None,
        pace=pace,
        luck=luck,
    )


def down(yaw: float) -> np.ndarray:
    """Returns a hand that points down; at a yaw of 0 its fingers open along the table."""
    return hand_axes(-UP, np.array([-np.cos(yaw), -np.sin(yaw), 0.0]))


def leaning(tilt: float, across: np.ndarray | None = None) -> np.ndarray:
    """Returns a hand that leans towards the cabinet.

    Args:
        tilt: Angle from pointing down, rad; at π/2 it points along +y.
        across: Direction in which fingers open, (3,); along the table by default.
    """
    z = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    x = np.array([-1.0, 0.0, 0.0]) if across is None else across
    return hand_axes(z, -x if x[0] > 0 else x)


class TablePath(Path):
    """Waypoints of a hand at CALVIN's table.

    Args:
        look: Where it begins.
    """

    def __init__(self, look: Look) -> None:
        gripper = 0.0 if look.held else GRASP_OPEN_M
        super().__init__(look.robot, look.hand_pos, look.hand_rot, gripper, look.pace)

    def over(self, pos: Sequence[float] | np.ndarray, rot: np.ndarray) -> Self:
        """Goes to a place by the lane along the table, above and in front of everything."""
        target = np.asarray(pos, dtype=np.float64)
        if np.linalg.norm(target[:2] - self.pos[:2]) < 0.05 and target[2] > self.pos[2]:
            return self.to(target, rot)
        if _leans(self.rot) and self.pos[1] > -0.03:
            self.to(self.pos - 0.1 * self.rot[:, 2])
        if self.pos[1] > -0.08 and self.pos[2] < LANE_Z_M + 0.05:
            self.to([self.pos[0], LANE_Y_M, max(self.pos[2] + 0.03, LANE_Z_M)], _upright(self.rot))
        elif self.pos[2] < LANE_Z_M - 0.01:
            self.to([self.pos[0], self.pos[1], LANE_Z_M], _upright(self.rot))
        if abs(target[0] - self.pos[0]) > 0.03 or target[1] > -0.08:
            self.to([target[0], min(LANE_Y_M, float(target[1])), LANE_Z_M], rot)
        return self.to(target, rot)


def _leans(rot: np.ndarray) -> bool:
    return bool(rot[2, 2] > -0.85)


def _upright(rot: np.ndarray) -> np.ndarray:
    """Returns a hand that points down in place of one that leans, which the arm cannot near its base."""
    return down(float(np.arctan2(-rot[1, 0], -rot[0, 0]))) if _leans(rot) else rot


def clear_of(place: np.ndarray, blocks: Sequence[Block], room_m: float) -> bool:
    """Returns whether a place (2,) on the desk is so far from blocks that lie there."""
    on_desk = [block for block in blocks if block.pos[2] > DESK_M - 0.01]
    return all(np.linalg.norm(place - block.pos[:2]) > room_m + block.radius_m for block in on_desk)
