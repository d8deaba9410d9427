"""CALVIN's expert: a plan of skills made from a task's rule, and from whatever state it is asked in.

What is in the way comes first: a block in the hand that the task does not ask for is put down, a door or a
drawer that is half open is moved on. After a miss the expert is asked again.
"""

from collections.abc import Callable

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.calvin.catalogue import task_facts
from envs.tasks.calvin.handling import (
    carry_sideways,
    drawer_is_reachable,
    lift,
    put_in_cabinet,
    put_in_drawer,
    put_on_block,
    put_on_desk,
    turn_block,
)
from envs.tasks.calvin.look import Look, look_at
from envs.tasks.calvin.memory import ANY_BLOCK, PART_BITS, ROBOT_BIT, SWITCH_ON_M
from envs.tasks.calvin.parts import move_door, move_drawer, press_button, push_switch
from envs.tasks.calvin_table import DRAWER_TRAVEL_M, SCALE

IN_CABINET_Y_M = 0.03
"""Blocks behind it lie in the cabinet."""

WRIST_M = 0.09
"""Half the width in which the wrist of a hand that leans into the cabinet comes low over the desk."""

CLEARS = 0.5
"""How often a block is moved out of the wrist's way, which most often passes."""

AFTER_MISS_M = 0.2
"""A hand so near a block in the cabinet may have just missed it: the wrist's way is then cleared first."""

HAND_HALF_M = 0.112
"""Half the width of the hand, along which fingers open."""


def plan(scene: str, task: str, robot: RobotCfg, state: State, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the waypoints of the next skill from a state of one row; empty gives up."""
    look = look_at(scene, robot, state, float(rng.uniform(0.9, 1.1)), float(rng.uniform()))
    kind, *arguments = task_facts()[task].rule
    if look.held is not None and kind not in ("place", "stack"):
        return put_on_desk(look, look.held, rng)
    return _PLANS[str(kind)](look, rng, *arguments)


def _rotate(look: Look, rng: np.random.Generator, block: str, degrees: float) -> list[Waypoint]:
    return turn_block(look, _colour(block), np.sign(degrees) * np.radians(rng.uniform(72.0, 80.0)))


def _push(look: Look, rng: np.random.Generator, block: str, metres: float) -> list[Waypoint]:
    return carry_sideways(look, _colour(block), float(np.sign(metres)), rng)


def _joint(look: Look, rng: np.random.Generator, joint: str, metres: float) -> list[Waypoint]:
    del rng
    if joint == "base__slide":
        return move_door(look, look.layout.travel * SCALE if metres > 0 else 0.0)
    return move_drawer(look, DRAWER_TRAVEL_M if metres > 0 else 0.0)


def _lift(look: Look, rng: np.random.Generator, block: str, metres: float, link: str) -> list[Waypoint]:
    del metres, link
    colour = _colour(block)
    return _make_way(look, rng, colour) or lift(look, colour).waypoints


def _make_way(look: Look, rng: np.random.Generator, colour: str) -> list[Waypoint]:
    """Moves the door or the drawer on if it keeps the hand from a block, or a block in the wrist's way."""
    block = look.blocks[colour]
    if block.pos[1] > IN_CABINET_Y_M:
        left, right = look.door_m()
        if left - HAND_HALF_M < block.pos[0] < right + HAND_HALF_M:
            goal = look.layout.travel * SCALE if block.pos[0] > (left + right) / 2 else 0.0
            if abs(goal - look.joints[0]) > 0.01:
                return move_door(look, goal)
        in_front = [
            b for b in look.others(colour) if b.pos[1] < 0.0 and abs(b.pos[0] - block.pos[0]) < WRIST_M
        ]
        missed = np.linalg.norm(look.hand_pos - block.pos) < AFTER_MISS_M
        if in_front and (missed or look.luck < CLEARS):
            other = in_front[0]
            return carry_sideways(look, other.colour, float(np.sign(other.pos[0] - block.pos[0]) or 1.0), rng)
    elif block.touches & PART_BITS["drawer"] and not drawer_is_reachable(look, float(block.pos[1])):
        return move_drawer(look, DRAWER_TRAVEL_M)
    return []


def _place(look: Look, rng: np.random.Generator, link: str) -> list[Waypoint]:
    if look.held is None:
        return _lift_lost(look)
    if link == "drawer_link":
        return put_in_drawer(look, look.held, rng)
    return put_in_cabinet(look, look.held)


def _lift_lost(look: Look) -> list[Waypoint]:
    """Returns the way to take up again what began in the hand."""
    lost = [block.colour for block in look.blocks.values() if block.began == ROBOT_BIT]
    return lift(look, lost[0]).waypoints if lost else []


def _push_into(look: Look, rng: np.random.Generator, source: str, target: str) -> list[Waypoint]:
    del source, target
    able = [b for b in look.blocks.values() if b.began == PART_BITS["base"] and b.touches & PART_BITS["base"]]
    if not able:
        return []
    if not drawer_is_reachable(look):
        return move_drawer(look, DRAWER_TRAVEL_M)
    colour = min(able, key=lambda block: abs(block.pos[0] - look.layout.drawer * SCALE)).colour
    return put_in_drawer(look, colour, rng, lift(look, colour))


def _stack(look: Look, rng: np.random.Generator) -> list[Waypoint]:
    del rng
    if look.held is None:
        return _lift_lost(look)
    return put_on_block(look, look.held)


def _unstack(look: Look, rng: np.random.Generator) -> list[Waypoint]:
    del rng
    tops = [b for b in look.blocks.values() if b.began & ANY_BLOCK and not b.began & ~ANY_BLOCK]
    return lift(look, tops[0].colour).waypoints if tops else []


def _light(look: Look, rng: np.random.Generator, light: str, before: float, after: float) -> list[Waypoint]:
    del before, rng
    if light == "led":
        return press_button(look)
    on = look.joints[3] > SWITCH_ON_M
    return push_switch(look, up=bool(after)) if on != bool(after) else []


def _colour(block: str) -> str:
    return block.removeprefix("block_")


_PLANS: dict[str, Callable[..., list[Waypoint]]] = {
    "rotate": _rotate,
    "push": _push,
    "joint": _joint,
    "lift": _lift,
    "place": _place,
    "push_into": _push_into,
    "stack": _stack,
    "unstack": _unstack,
    "light": _light,
}
