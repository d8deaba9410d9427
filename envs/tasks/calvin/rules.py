"""CALVIN's 34 rules of success (``calvin_env/envs/tasks.py``, MIT): changes since the episode began.

Each function returns (N,) bool. Contacts are those of bodies; the robot's are read off the blocks: what it
touches beside them does not count.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from envs.rotations import conjugate, multiply, to_matrix
from envs.state import State
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin.memory import ANY_BLOCK, BLOCK_BITS, PART_BITS, ROBOT_BIT

JOINTS = {"base__slide": 0, "base__drawer": 1}

LINKS = {"base_link": "base", "plank_link": "plank", "drawer_link": "drawer"}

MOST_TURN_RAD = torch.pi
MOST_TIP_RAD = 30.0 * torch.pi / 180.0
MOST_MOVED_M = 0.1
MOST_SPEED = 1.0
"""Of a stacked block, along and about each axis, m/s and rad/s."""


def met(rule: tuple[str | float, ...], state: State) -> Tensor:
    """Returns whether a rule of ``tasks.json`` holds."""
    kind, *arguments = rule
    return _RULES[str(kind)](state, *arguments)


def may_be_met(rule: tuple[str | float, ...], state: State) -> Tensor:
    """Returns whether a rule can be met by what touched the blocks and was lit at the start, (N,) bool."""
    kind, *arguments = rule
    asks = _MAY_BE_MET.get(str(kind))
    if asks is None:
        return torch.ones(state.num_envs, dtype=torch.bool, device=state.device)
    return asks(state, *arguments)


def _colour(block: str) -> str:
    return block.removeprefix("block_")


def rotated(state: State, block: str, degrees: float) -> Tensor:
    """A block was turned about z by more than an angle, hardly tipped or moved, and something holds it."""
    now, start = state.objects[block], memory.start_block(state, _colour(block))
    # Roll, pitch and yaw about fixed axes, as SciPy's as_euler("xyz").
    turn = to_matrix(multiply(now.rot, conjugate(start.rot)))
    roll = torch.atan2(turn[:, 2, 1], turn[:, 2, 2])
    pitch = -torch.asin(turn[:, 2, 0].clamp(-1.0, 1.0))
    yaw = torch.atan2(turn[:, 1, 0], turn[:, 0, 0])
    least = abs(degrees) * torch.pi / 180.0
    signed = yaw if degrees > 0 else -yaw
    near = (now.pos - start.pos).norm(dim=-1) <= MOST_MOVED_M
    held = (memory.touches(state, _colour(block)) & ~ROBOT_BIT) > 0
    upright = (roll.abs() < MOST_TIP_RAD) & (pitch.abs() < MOST_TIP_RAD)
    return (signed > least) & (signed < MOST_TURN_RAD) & upright & near & held


def pushed(state: State, block: str, metres: float) -> Tensor:
    """A block moved along x by more than a distance; what it touched it still touches, the robot aside."""
    moved = state.objects[block].pos[:, 0] - memory.start_block(state, _colour(block)).pos[:, 0]
    start = memory.start_touches(state, _colour(block)) & ~ROBOT_BIT
    far = moved > metres if metres > 0 else moved < metres
    still = (start & ~memory.touches(state, _colour(block))) == 0
    return far & still & _may_be_pushed(state, block, metres)


def _may_be_pushed(state: State, block: str, metres: float) -> Tensor:
    """Something other than the robot touched the block at the start."""
    del metres
    return (memory.start_touches(state, _colour(block)) & ~ROBOT_BIT) > 0


def joint_moved(state: State, joint: str, metres: float) -> Tensor:
    """Door or drawer moved by more than a distance."""
    column = JOINTS[joint]
    moved = memory.joints(state)[:, column] - memory.start_joints(state)[:, column]
    return moved > metres if metres > 0 else moved < metres


def lifted(state: State, block: str, metres: float, link: str) -> Tensor:
    """A block that lay on a link is higher by more than a distance, and only the robot touches it."""
    colour = _colour(block)
    higher = state.objects[block].pos[:, 2] - memory.start_block(state, colour).pos[:, 2] > metres
    alone = memory.touches(state, colour) == ROBOT_BIT
    return higher & alone & _may_be_lifted(state, block, metres, link)


def _may_be_lifted(state: State, block: str, metres: float, link: str) -> Tensor:
    del metres
    return (memory.start_touches(state, _colour(block)) & PART_BITS[LINKS[link]]) > 0


def placed(state: State, link: str) -> Tensor:
    """The one block that was in the hand lies on a link, and the robot does not touch it."""
    return (_one_in_hand(state) & _lie_on(state, link)).any(-1)


def _one_in_hand(state: State) -> Tensor:
    """Returns which block the robot alone touched, where it touched no other one, (N, 3) bool."""
    began = _began(state)
    one = ((began & ROBOT_BIT) > 0).sum(-1, keepdim=True) == 1
    return one & (began == ROBOT_BIT)


def pushed_into(state: State, source: str, target: str) -> Tensor:
    """Some block that touched one link alone touches another one, and the robot does not."""
    return (_lay_alone(state, source) & _lie_on(state, target)).any(-1)


def _lay_alone(state: State, link: str) -> Tensor:
    return _began(state) == PART_BITS[LINKS[link]]


def stacked(state: State) -> Tensor:
    """Some block that touched none touches blocks alone, and is slow."""
    blocks = [state.objects[f"block_{colour}"] for colour in BLOCKS]
    speeds = torch.stack([torch.cat([block.lin_vel, block.ang_vel], -1) for block in blocks], 1)
    slow = (speeds.abs() < MOST_SPEED).all(-1)
    return (_touched_no_block(_began(state)) & _touched_blocks_alone(_now(state)) & slow).any(-1)


def unstacked(state: State) -> Tensor:
    """Some block that touched blocks alone touches none."""
    return (_touched_blocks_alone(_began(state)) & _touched_no_block(_now(state))).any(-1)


def _touched_no_block(codes: Tensor) -> Tensor:
    return (codes & ANY_BLOCK) == 0


def _touched_blocks_alone(codes: Tensor) -> Tensor:
    return ~_touched_no_block(codes) & ((codes & ~ANY_BLOCK) == 0)


def _lie_on(state: State, link: str) -> Tensor:
    """Returns which blocks touch a link and not the robot, (N, 3) bool."""
    now = _now(state)
    return ((now & PART_BITS[LINKS[link]]) > 0) & ((now & ROBOT_BIT) == 0)


def _now(state: State) -> Tensor:
    """Returns what touches each block, (N, 3)."""
    return torch.stack([memory.touches(state, colour) for colour in BLOCKS], -1)


def _began(state: State) -> Tensor:
    """Returns what touched each block at the start, (N, 3)."""
    return torch.stack([memory.start_touches(state, colour) for colour in BLOCKS], -1)


def switched(state: State, light: str, before: float, after: float) -> Tensor:
    """A light was in one state and is in another."""
    _, now = _light(state, light)
    return _may_be_switched(state, light, before, after) & (now == bool(after))


def _may_be_switched(state: State, light: str, before: float, after: float) -> Tensor:
    del after
    return _light(state, light)[0] == bool(before)


def _light(state: State, light: str) -> tuple[Tensor, Tensor]:
    """Returns whether a light was lit at the start, and whether it is now."""
    return memory.led(state) if light == "led" else memory.bulb(state)


_MAY_BE_MET: dict[str, Callable[..., Tensor]] = {
    "push": _may_be_pushed,
    "lift": _may_be_lifted,
    "place": lambda state, _: _one_in_hand(state).any(-1),
    "push_into": lambda state, source, _: _lay_alone(state, source).any(-1),
    "stack": lambda state: _touched_no_block(_began(state)).any(-1),
    "unstack": lambda state: _touched_blocks_alone(_began(state)).any(-1),
    "light": _may_be_switched,
}

_RULES: dict[str, Callable[..., Tensor]] = {
    "rotate": rotated,
    "push": pushed,
    "joint": joint_moved,
    "lift": lifted,
    "place": placed,
    "push_into": pushed_into,
    "stack": stacked,
    "unstack": unstacked,
    "light": switched,
}

__all__ = ["BLOCK_BITS", "may_be_met", "met"]
