"""What the tests of several simulators do with a handler of each."""

import numpy as np
import torch

from envs.handlers import HANDLERS
from envs.tasks.pick_cube import PickCube


def launched(simulator, scenario, num_envs=1, **options):
    """A simulator that runs."""
    handler = HANDLERS.get(simulator)(scenario, num_envs, renderer="warp", **options)
    handler.launch()
    return handler


def start(task, num_envs=1):
    """Initial states of a task."""
    return task.initial_state([np.random.default_rng(i) for i in range(num_envs)])


def reach(simulator):
    """Joint positions, (10, 1, 9), all along half a second of the arm's way to other targets."""
    task, way = PickCube(), []
    with launched(simulator, task.scenario) as handler:
        states = start(task)
        handler.set_states(states)
        target = states.robots["franka"].joint_pos.clone()
        target += torch.tensor([0.3, -0.2, 0.15, 0.1, -0.15, 0.1, 0.2, -0.02, -0.02])
        handler.set_joint_targets({"franka": target})
        for _ in range(10):
            handler.step(25)
            way.append(handler.get_states().robots["franka"].joint_pos.double())
    return torch.stack(way)


def with_block(simulator, **settings):
    """PickCube's scenario with a block of a simulator's settings."""
    import dataclasses

    return dataclasses.replace(PickCube().scenario, simulators={simulator: settings})
