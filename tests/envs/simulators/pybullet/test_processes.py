"""Bullet holds one environment after the other in a process; several processes hold several at once."""

import dataclasses

import numpy as np
import pytest
import torch

pytest.importorskip("pybullet")

from envs.simulators.processes import ProcessHandler
from envs.simulators.pybullet.handler import PybulletHandler
from envs.tasks.close_box import CloseBox

NUM_ENVS = 3


def test_an_articulated_object_moves_and_looks_as_without_processes():
    task = CloseBox()
    cameras = tuple(dataclasses.replace(camera, width=16, height=16) for camera in task.scenario.cameras[:1])
    scenario = dataclasses.replace(task.scenario, cameras=cameras)
    states = task.initial_state([np.random.default_rng(index) for index in range(NUM_ENVS)])
    target = states.robots["franka"].joint_pos + 0.02
    found = []
    for handler in (
        ProcessHandler(scenario, NUM_ENVS, simulator="pybullet", num_processes=2),
        PybulletHandler(scenario, NUM_ENVS),
    ):
        with handler:
            handler.launch()
            handler.set_states(states)
            handler.step_towards({"franka": target}, 4)
            handler.step(10, [0, 2])
            found.append((handler.get_states().flatten(), handler.render(None, ("rgb", "depth"))))
    (ours, our_pictures), (theirs, their_pictures) = found
    for key, value in theirs.items():
        assert torch.equal(ours[key], value), key
    camera = cameras[0].name
    for kind in ("rgb", "depth"):
        np.testing.assert_array_equal(our_pictures[camera][kind], their_pictures[camera][kind])
