"""Moving a part of an articulated object along its joint: a drawer, a door, a knob, a lid."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from envs.kinematics.object_parts import ObjectParts, PartBox
from envs.kinematics.waypoints import Waypoint
from envs.rotations import rotate, to_matrix, wrapped
from envs.state import EntityState
from envs.tasks.skills.clouds import Heights
from envs.tasks.skills.hands import FINGER_HALF_M, TIP_BELOW_M, hand_underside
from envs.tasks.skills.moves import Hand, follow, reach_over

STANDOFF_M = 0.10
"""Distance from a handle at which the hand begins to come straight to it."""

PUSH_PITCH = np.radians(50.0)
"""Angle between straight down and where closed fingers point that push: the wrist stays over what stands on
the table, and the palm clear of the handles above."""

PULL_OPENING_M = 0.025


def outward(parts: ObjectParts, entity: EntityState, part: int, opens: float) -> np.ndarray:
    """Returns the direction (3,) in the world in which a sliding part opens.

    Args:
        parts: The object.
        entity: Its state, of one row.
        part: The part.
        opens: Sign of the joint's change that opens it.
    """
    joint = parts.parts[part].joint
    assert joint is not None, "a drawer slides"
    _, rot = parts.part_pose(entity, part)
    return opens * rotate(rot[0].numpy(), joint.axis)


def handle_of(parts: ObjectParts, entity: EntityState, part: int, direction: np.ndarray) -> PartBox:
    """Returns the box of a part that sticks out farthest in a direction."""
    boxes = [box for box in parts.boxes if box.part == part]
    pos, rot = (values[0].numpy() for values in parts.part_pose(entity, part))
    middles = pos + rotate(rot, np.array([box.pos for box in boxes]))
    return max(zip(boxes, middles, strict=True), key=lambda item: float(item[1] @ direction))[0]


def moved_to(entity: EntityState, column: int, position: float) -> EntityState:
    """Returns a state with a joint at another position."""
    joints = entity.joint_pos.clone()
    joints[:, column] = position
    return replace(entity.select(torch.arange(len(joints))), joint_pos=joints)


def half_along(parts: ObjectParts, entity: EntityState, box: PartBox, direction: np.ndarray) -> float:
    """Returns half the extent of a box in a direction, m."""
    axes = to_matrix(parts.box_pose(entity, box)[1][0].numpy())
    return float(np.abs(axes.T @ direction) @ box.half)


def along_joint(contact: Callable[[float], Waypoint], now: float, to: float, stops: int) -> list[Waypoint]:
    """Returns the way of a hand that moves a part along its joint, which it holds or pushes.

    Args:
        contact: Where the hand is when the joint is at a position; its time is that of the way between stops.
        now: Position of the joint, rad (m).
        to: Position to reach.
        stops: Stops on the way, evenly spaced: between them the hand moves straight.
    """
    return [contact(position) for position in np.linspace(now, to, stops + 1)[1:].tolist()]


def slide_part(
    hand: Hand,
    parts: ObjectParts,
    entity: EntityState,
    part: int,
    to: float,
    opens: float,
    heights: Heights,
) -> list[Waypoint]:
    """Returns the way that pulls a drawer open by its handle, or pushes it in with closed fingers.

    Args:
        hand: The hand.
        parts: The object.
        entity: Its state, of one row.
        part: The drawer.
        to: Joint position to reach, m.
        opens: Sign of the joint's change that opens it.
        heights: Everything.
    """
    joint = parts.parts[part].joint
    assert joint is not None, "a drawer slides"
    out = outward(parts, entity, part, opens)
    box = handle_of(parts, entity, part, out)
    place = parts.box_pose(entity, box)[0][0].numpy()
    pulls = (to - float(entity.joint_pos[0, joint.column])) * opens > 0
    way = (to - float(entity.joint_pos[0, joint.column])) * opens * out
    turn = _across(-out) if pulls else _down_and_to(-out)
    if pulls:
        grip, before, fingers = place, PULL_OPENING_M, 0.0
    else:
        grip = place + (half_along(parts, entity, box, out) + TIP_BELOW_M) * out
        grip[2] += 0.004
        before, fingers = 0.0, 0.0
    far = grip + STANDOFF_M * out
    top = max(heights.along(hand.pos[:2], far[:2], hand_underside(0.0)) + 0.12, float(far[2]))
    high = np.array([far[0], far[1], top])
    end = grip + way
    stops = [
        _stop(np.array([*hand.pos[:2], max(top, hand.pos[2])]), before, {"yaw": 0.0, "pitch": hand.tilt}),
        _stop(high, before, turn, 0.3),
        _stop(far, before, turn),
        _stop(grip, before, turn, 0.1, hold_s=0.1),
        _stop(grip, fingers, turn, 0.1, hold_s=0.25 if pulls else 0.0),
        _stop(end, fingers, turn, 0.5, hold_s=0.15),
        _stop(end, before, turn, 0.1, hold_s=0.15),
        _stop(end + STANDOFF_M * out, before, turn),
        _stop(np.array([*(end + STANDOFF_M * out)[:2], top]), 0.04, {"yaw": 0.0, "pitch": hand.tilt}, 0.3),
    ]
    return follow(hand, stops)


def push_door(
    hand: Hand, parts: ObjectParts, entity: EntityState, part: int, to: float, heights: Heights
) -> list[Waypoint]:
    """Returns the way that pushes a door along its arc, with closed fingers from outside, at its handle.

    Args:
        hand: The hand.
        parts: The object.
        entity: Its state, of one row.
        part: The door, whose hinge is vertical.
        to: Joint position to reach, rad.
        heights: Everything.
    """
    joint = parts.parts[part].joint
    assert joint is not None, "a door turns"
    now = float(entity.joint_pos[0, joint.column])
    boxes = [box for box in parts.boxes if box.part == part]
    handle = max(boxes, key=lambda box: float(np.linalg.norm((box.pos - joint.anchor)[:2])))
    stops: list[Waypoint] = []
    outside, lead = hand.pos, list[Waypoint]()
    for position in np.linspace(now, to, 10):
        at = moved_to(entity, joint.column, float(position))
        later = moved_to(entity, joint.column, float(position) + np.sign(to - now) * 0.01)
        pos, ahead = (parts.box_pose(state, handle)[0][0].numpy() for state in (at, later))
        push = (ahead - pos) / np.linalg.norm(ahead - pos)
        thick = half_along(parts, at, handle, push)
        place = pos - (thick + FINGER_HALF_M[0]) * push + np.array([0.0, 0.0, 0.01])
        yaw = float(np.arctan2(push[1], push[0]))
        yaw = (yaw + np.pi / 2) % np.pi - np.pi / 2
        if stops:  # the nearest of the two turns that look alike
            yaw += np.pi * round((stops[-1].yaw - yaw) / np.pi)
        else:
            outside = place - 0.05 * push
            lead = reach_over(hand, outside, yaw, 0.0, heights)
        stops.append(_stop(place, 0.0, {"yaw": yaw, "pitch": hand.tilt}, 0.1))
    end = stops[-1]
    stops.append(replace(end, pos=end.pos + np.array([0.0, 0.0, 0.15]), duration_s=0.3))
    return [*lead, *follow(replace(hand, pos=outside), stops)]


def turn_knob(
    hand: Hand, parts: ObjectParts, entity: EntityState, part: int, to: float, heights: Heights
) -> list[Waypoint]:
    """Returns the way that grasps the bar of a knob from above and turns it.

    Args:
        hand: The hand.
        parts: The object.
        entity: Its state, of one row.
        part: The knob, whose joint is vertical.
        to: Joint position to reach, rad.
        heights: Everything.
    """
    joint = parts.parts[part].joint
    assert joint is not None, "a knob turns"
    box = handle_of(parts, entity, part, np.array([0.0, 0.0, 1.0]))
    pos, rot = (values[0].numpy() for values in parts.box_pose(entity, box))
    axes = to_matrix(rot)
    level = [axis for axis in range(3) if abs(axes[2, axis]) < 0.5]
    across = min(level, key=lambda axis: box.half[axis])
    now = float(entity.joint_pos[0, joint.column])
    turn = rotate(parts.part_pose(entity, part)[1][0].numpy(), joint.axis)[2] * (to - now)
    yaw = float(np.arctan2(axes[1, across], axes[0, across])) - np.pi / 2
    yaws = [wrapped(yaw + half) for half in (0.0, np.pi)]
    yaw = min(yaws, key=lambda value: max(abs(value), abs(value + turn)))
    top = pos[2] + half_along(parts, entity, box, np.array([0.0, 0.0, 1.0]))
    grip = np.array([pos[0], pos[1], top - 0.014])
    way = reach_over(hand, grip + np.array([0.0, 0.0, 0.06]), yaw, 0.04, heights)
    stops = [
        _stop(grip, 0.04, {"yaw": yaw, "pitch": hand.tilt}, hold_s=0.1),
        _stop(grip, 0.0, {"yaw": yaw, "pitch": hand.tilt}, 0.1, hold_s=0.2),
    ]

    def turned(share: float) -> Waypoint:
        at = parts.box_pose(moved_to(entity, joint.column, now + share * (to - now)), box)[0][0].numpy()
        return _stop(np.array([at[0], at[1], grip[2]]), 0.0, {"yaw": yaw + share * turn, "pitch": hand.tilt})

    stops += along_joint(turned, 0.0, 1.0, 5)
    end = stops[-1]
    stops.append(replace(end, gripper=0.04, duration_s=0.1, hold_s=0.2))
    stops.append(replace(end, gripper=0.04, pos=end.pos + np.array([0.0, 0.0, 0.1])))
    return [*way, *follow(replace(hand, pos=way[-1].pos), stops)]


def _stop(
    pos: np.ndarray, gripper: float, turn: dict[str, float], base_s: float = 0.2, hold_s: float = 0.0
) -> Waypoint:
    return Waypoint(pos=pos, gripper=gripper, duration_s=base_s, hold_s=hold_s, **turn)


def _across(direction: np.ndarray) -> dict[str, float]:
    """Returns the turn of a hand that points in a level direction, and whose fingers close vertically."""
    angle = float(np.arctan2(direction[1], direction[0]))
    choices = [(angle - np.pi / 2, np.pi / 2), (angle + np.pi / 2, -np.pi / 2)]
    yaw, roll = min(((float(wrapped(yaw)), roll) for yaw, roll in choices), key=lambda choice: abs(choice[0]))
    return {"yaw": yaw, "roll": roll, "pitch": 0.0}


def _down_and_to(direction: np.ndarray) -> dict[str, float]:
    """Returns the turn of a hand that points down and to a level direction, and whose fingers close level."""
    angle = float(np.arctan2(direction[1], direction[0]))
    choices = [(angle - np.pi, PUSH_PITCH), (angle, -PUSH_PITCH)]
    yaw, pitch = min(
        ((float(wrapped(yaw)), pitch) for yaw, pitch in choices), key=lambda choice: abs(choice[0])
    )
    return {"yaw": yaw, "pitch": pitch, "roll": 0.0}
