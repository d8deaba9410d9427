"""One small scene, launched once: compiling the kernels is what takes long."""

import dataclasses

import numpy as np
import pytest

from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.tasks.pick_cube import PickCube

NUM_ENVS = 4


def scene(**settings):
    """PickCube with a small image; ``settings`` are the simulator's."""
    scenario = PickCube().scenario
    cameras = tuple(dataclasses.replace(camera, width=64, height=64) for camera in scenario.cameras)
    return dataclasses.replace(
        scenario, cameras=cameras, simulators={"mujoco_warp": {"device": "cpu", **settings}}
    )


def images_of(name, size):
    """Every material has a colour of its own, in squares."""
    rng = np.random.default_rng(sum(map(ord, name)))
    return np.kron(rng.integers(0, 255, (8, 8, 3)), np.ones((size // 8, size // 8, 1))).astype(np.uint8)


def starts(count=NUM_ENVS, seed=0):
    return PickCube().initial_state([np.random.default_rng(seed + i) for i in range(count)])


@pytest.fixture(scope="session")
def handler():
    with MujocoWarpHandler(scene(), NUM_ENVS, textures=images_of) as handler:
        handler.launch()
        yield handler
