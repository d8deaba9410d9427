"""States of an arm at a table, made by hand."""

import numpy as np
import torch

from envs.rotations import from_yaw


def vector(*values):
    return torch.tensor([values], dtype=torch.float64)


def starts(task, count=1):
    """Initial states, completed as a simulator does: an open hand 0.3 m above the origin, at rest."""
    state = task.initial_state([np.random.default_rng(row) for row in range(count)])
    robot = state.robots["franka"]
    robot.ee_pos = torch.tensor([[0.0, 0.0, 0.3]], dtype=torch.float64).repeat(count, 1)
    robot.ee_rot = torch.tensor([[0.0, 1.0, 1.0, 0.0]], dtype=torch.float64).repeat(count, 1) / np.sqrt(2)
    robot.joint_target = robot.joint_pos.clone()
    for item in task.scenario.objects:
        if item.feels:
            state.objects[item.name].touched = torch.zeros((count, len(item.feels)), dtype=torch.float64)
    return state


def put(state, name, pos, yaw=0.0):
    state.objects[name].pos = vector(*pos)
    state.objects[name].rot = torch.from_numpy(from_yaw(np.array([yaw])))


def grip(state, pos, width_m):
    """Puts the hand at a place, its fingers closing on something that wide."""
    robot = state.robots["franka"]
    robot.ee_pos = vector(*pos)
    robot.joint_pos[:, 7:] = width_m / 2
    robot.joint_target[:, 7:] = 0.0


def assert_fills(values, low, high):
    span = high - low
    assert low <= values.min() < low + 0.01 * span
    assert high >= values.max() > high - 0.01 * span
