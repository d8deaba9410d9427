"""States of CALVIN's scene D, made by hand."""

import numpy as np
import torch

from envs.rotations import from_euler
from envs.state import EntityState, State
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin.memory import ANY_BLOCK, BLOCK_BITS, GROUND_BIT, PART_BITS, ROBOT_BIT
from envs.tasks.calvin.scene import TABLE

BASE, PLANK, DRAWER = (PART_BITS[part] for part in ("base", "plank", "drawer"))
ROBOT = ROBOT_BIT
BLOCK = BLOCK_BITS

START_POS = {"red": (0.05, -0.12, 0.46), "blue": (0.23, -0.12, 0.46), "pink": (0.07, 0.09, 0.46)}
START_TOUCHES = {"red": BASE, "blue": BASE, "pink": PLANK}


def block(pos, euler_deg=(0.0, 0.0, 0.0), touched=0, colour="red", speed=0.0):
    """Returns a block of one row; ``euler_deg`` is yaw, pitch and roll."""
    entity = EntityState.at_rest(np.array([pos]), from_euler(np.radians(np.array([euler_deg]))))
    entity.lin_vel[:, 0] = speed
    others = [BLOCK_BITS[other] for other in BLOCKS if other != colour]
    bits = [ROBOT_BIT, *others, *PART_BITS.values(), GROUND_BIT]
    entity.touched = torch.tensor([[float(bool(touched & bit)) for bit in bits]], dtype=torch.float64)
    assert touched & BLOCK_BITS[colour] == 0 and ANY_BLOCK
    return entity


def state(joints=(0.0, 0.0, 0.0, 0.0), start_joints=None, now=None, start=None, led=(False, False)):
    """Returns a state of one row.

    Args:
        joints: Door, drawer, button and switch.
        start_joints: The same at the start.
        now: Colour to block, where it is not as at the start.
        start: Colour to block at the start, where it is not at ``START_POS``.
        led: Whether the LED was lit at the start, and whether it was when that was last noted.
    """
    usual = {c: block(START_POS[c], touched=START_TOUCHES[c], colour=c) for c in BLOCKS}
    first = usual | (start or {})
    first_joints = torch.tensor([joints if start_joints is None else start_joints], dtype=torch.float64)
    table = EntityState.at_rest(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([joints]))
    objects = {TABLE: table} | {f"block_{c}": entity for c, entity in (first | (now or {})).items()}
    touched = {c: memory.touches(State({}, {f"block_{c}": first[c]}), c) for c in BLOCKS}
    lights = [torch.tensor([value]) for value in led]
    for name, (pos, rot) in memory.marks(first_joints, first, touched, *lights).items():
        objects[name] = EntityState.at_rest(pos.numpy(), rot.numpy())
    return State({}, objects)
