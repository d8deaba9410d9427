"""How an episode began, carried in its states: CALVIN's rules compare with it.

Markers that are not seen carry it: simulators keep a marker where an episode puts it, and it is part of every
state that is recorded, set or compared. The pose of ``start_<colour>`` is that of the block at the start. The
position of ``start_joints`` is door, drawer and switch; that of ``start_touches`` says what touched each
block; that of ``start_led`` says whether the LED was lit at the start, whether it is lit, and whether the
button was down when that was last noted. Shapes: N environments.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from envs.core.errors import SimulatorError
from envs.state import EntityState, State
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin.scene import BUTTON, DRAWER, HIDDEN_Z_M, LIT, PARTS, SLIDE, SWITCH, TABLE
from envs.tasks.calvin_table import SCALE, SWITCH_TRAVEL_M

ROBOT_BIT = 1
BLOCK_BITS = {colour: 2 << index for index, colour in enumerate(BLOCKS)}
PART_BITS = {part: 16 << index for index, part in enumerate(PARTS)}
GROUND_BIT = 16 << len(PARTS)

ANY_BLOCK = sum(BLOCK_BITS.values())

_UNIT_M = 1e-3
"""Of a number that is kept as a position: markers stay near the scene."""

SWITCH_ON_M = SWITCH_TRAVEL_M / 2
"""The bulb is lit while the switch is beyond half its way (``objects/switch.py``)."""

BUTTON_DOWN_M = 0.0125 * SCALE
"""The LED changes whenever the button comes beyond half its way (``objects/button.py``)."""


def touches(state: State, colour: str) -> Tensor:
    """Returns what touches a block, as a sum of bits, (N,) int64.

    Raises:
        SimulatorError: The simulator does not report contacts.
    """
    entity = state.objects[f"block_{colour}"]
    if entity.touched is None:
        raise SimulatorError(
            "CALVIN's rules need contacts, which this simulator does not report. Use simulator=mujoco or "
            "simulator=mujoco_warp."
        )
    others = [BLOCK_BITS[other] for other in BLOCKS if other != colour]
    bits = [ROBOT_BIT, *others, *PART_BITS.values(), GROUND_BIT]
    weights = torch.tensor(bits, dtype=torch.long, device=entity.touched.device)
    return ((entity.touched > 0.5).long() * weights).sum(-1)


def joints(state: State) -> Tensor:
    """Returns door, drawer and switch, m, (N, 3)."""
    return state.objects[TABLE].joint_pos[:, [SLIDE, DRAWER, SWITCH]]


def start_joints(state: State) -> Tensor:
    """Returns the same at the start of the episode."""
    return state.objects["start_joints"].pos


def start_touches(state: State, colour: str) -> Tensor:
    """Returns what touched a block at the start, as :func:`touches` does."""
    return (state.objects["start_touches"].pos[:, BLOCKS.index(colour)] / _UNIT_M).round().long()


def start_block(state: State, colour: str) -> EntityState:
    """Returns a marker whose pose is that of a block at the start."""
    return state.objects[f"start_{colour}"]


def led(state: State) -> tuple[Tensor, Tensor]:
    """Returns whether the LED was lit at the start, and whether it is lit, both (N,) bool."""
    began, noted, was_down = (state.objects["start_led"].pos / _UNIT_M > 0.5).unbind(-1)
    down = state.objects[TABLE].joint_pos[:, BUTTON] > BUTTON_DOWN_M
    return began, noted ^ (down & ~was_down)


def bulb(state: State) -> tuple[Tensor, Tensor]:
    """Returns the same of the light bulb."""
    return start_joints(state)[:, 2] > SWITCH_ON_M, joints(state)[:, 2] > SWITCH_ON_M


def marks(
    joint_pos: Tensor,
    blocks: dict[str, EntityState],
    touched: dict[str, Tensor],
    led_at_start: Tensor,
    led_now: Tensor,
) -> dict[str, tuple[Tensor, Tensor]]:
    """Returns poses, positions (N, 3) and orientations (N, 4), of all markers.

    Args:
        joint_pos: Joints of the table, (N, 4).
        blocks: Colour to block, as they are to be remembered.
        touched: Colour to what touches it, (N,) int64.
        led_at_start: Whether the LED counts as lit at the start, (N,) bool.
        led_now: Whether it is lit, (N,) bool.
    """
    flat = torch.zeros_like(joint_pos[:, :4])
    flat[:, 0] = 1.0
    codes = torch.stack([touched[colour] for colour in BLOCKS], -1).to(joint_pos.dtype)
    down = joint_pos[:, BUTTON] > BUTTON_DOWN_M
    lights = torch.stack([led_at_start, led_now, down], -1).to(joint_pos.dtype)
    poses = {f"start_{colour}": (blocks[colour].pos, blocks[colour].rot) for colour in BLOCKS}
    poses["start_joints"] = (joint_pos[:, [SLIDE, DRAWER, SWITCH]], flat)
    poses["start_touches"] = (codes * _UNIT_M, flat)
    poses["start_led"] = (lights * _UNIT_M, flat)
    for name, lit in zip(LIT, (led_now, joint_pos[:, SWITCH] > SWITCH_ON_M), strict=True):
        place = torch.zeros_like(joint_pos[:, :3])
        place[:, 2] = torch.where(lit, 0.0, HIDDEN_Z_M)
        poses[name] = (place, flat)
    return poses


def begun_here(state: State, rows: Sequence[int] | None = None) -> dict[str, tuple[Tensor, Tensor]]:
    """Returns poses of all markers by which the present state is a start; the lights stay as they are.

    Args:
        state: The present state.
        rows: Rows for which it is; None means all. Others keep their start, and have their lights noted.
    """
    _, lit = led(state)
    began = led(state)[0]
    fresh = torch.ones_like(lit) if rows is None else torch.zeros_like(lit)
    if rows is not None:
        fresh[list(rows)] = True
    table = state.objects[TABLE].joint_pos
    blocks = {colour: state.objects[f"block_{colour}"] for colour in BLOCKS}
    new = marks(table, blocks, {c: touches(state, c) for c in BLOCKS}, torch.where(fresh, lit, began), lit)
    for name in (*(f"start_{colour}" for colour in BLOCKS), "start_joints", "start_touches"):
        old = state.objects[name]
        pos, rot = new[name]
        new[name] = torch.where(fresh[:, None], pos, old.pos), torch.where(fresh[:, None], rot, old.rot)
    return new
