"""What the tests of several simulators do with a handler of each."""

import numpy as np
import pytest
import torch

from envs.core.errors import UnknownNameError
from envs.simulators import HANDLERS
from envs.tasks.close_box import CloseBox
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


def lid_left_alone(simulator):
    """CloseBox's box as it begins, as it was put into a simulator, and 100 steps later."""
    task = CloseBox()
    with launched(simulator, task.scenario) as handler:
        states = start(task)
        handler.set_states(states)
        before = handler.get_states().objects
        name = next(name for name, entity in before.items() if entity.joint_pos.shape[1])
        handler.step(100)
        return states.objects[name], before[name], handler.get_states().objects[name]


def assert_friction_holds_the_lid(simulator):
    """The box stays where it is, and its lid all but so."""
    _, before, after = lid_left_alone(simulator)
    assert torch.equal(after.pos, before.pos)
    torch.testing.assert_close(after.joint_pos, before.joint_pos, atol=2e-2, rtol=0.0)


def assert_refused(simulator, setting):
    """A setting that a simulator does not have is named, and the nearest one."""
    message = rf"Unknown setting of simulator={simulator} '{setting}'.*Did you mean"
    with pytest.raises(UnknownNameError, match=message):
        HANDLERS.get(simulator)(with_block(simulator, **{setting: 20}), 1)


def with_block(simulator, **settings):
    """PickCube's scenario with a block of a simulator's settings."""
    import dataclasses

    return dataclasses.replace(PickCube().scenario, simulators={simulator: settings})
