"""HumanoidBench's own scene in plain MuJoCo, and its rewards written out by hand, one state at a time."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

DATA = Path(os.environ.get("ROBOVERSE_DATA", Path(__file__).resolve().parents[5] / "shared" / "data"))
ASSETS = DATA / "humanoid_bench" / "assets"

needs_assets = pytest.mark.skipif(
    not (ASSETS / "envs").is_dir(), reason="HumanoidBench's folder is not there; set ROBOVERSE_DATA"
)


def published_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(ASSETS / "envs" / "h1_pos_walk.xml"))


def put(model, data, state) -> None:
    """Puts a state of one row of the H1 into MuJoCo's arrays, and brings everything up to date."""
    robot = state.robots["h1"]
    parts = (robot.pos, robot.rot, robot.joint_pos), (robot.lin_vel, robot.ang_vel, robot.joint_vel)
    data.qpos[:] = np.concatenate([part[0].numpy() for part in parts[0]])
    data.qvel[:] = np.concatenate([part[0].numpy() for part in parts[1]])
    data.ctrl[:] = robot.joint_target[0].numpy()
    mujoco.mj_forward(model, data)


def gaussian(distance: float, margin: float) -> float:
    return 0.1 ** ((max(distance, 0.0) / margin) ** 2)


def linear(distance: float, margin: float) -> float:
    return max(0.0, 1.0 - max(distance, 0.0) / margin)


class Published:
    """What ``robots.py`` reads of a state, and what ``basic_locomotion_envs.py`` makes of it."""

    def __init__(self, data: mujoco.MjData) -> None:
        self.head = data.site("head").xpos[2]
        self.imu = data.site("imu").xpos.copy()
        self.feet = (data.site("left_foot").xpos[2], data.site("right_foot").xpos[2])
        self.upright = data.body("torso_link").xmat[8]
        self.velocity = data.sensor("pelvis_subtreelinvel").data.copy()
        self.pelvis = data.body("pelvis").xquat.copy()
        forces = data.actuator_force
        small = np.mean([max(0.0, 1.0 - (force / 10.0) ** 2) for force in forces])
        self.small_control = (4.0 + small) / 5.0

    def stand_reward(self, upright: float = 0.9, height: float = 1.65) -> float:
        return gaussian(height - self.head, 1.65 / 4) * linear(upright - self.upright, 1.9)

    def move(self, speed: float) -> float:
        return (5.0 * linear(speed - self.velocity[0], speed) + 1.0) / 6.0

    def still(self) -> float:
        return float(np.mean([gaussian(abs(speed), 2.0) for speed in self.velocity[:2]]))

    def reward(self, task: str) -> float:
        base = self.small_control * self.stand_reward()
        return (
            base
            * {"stand": self.still, "walk": lambda: self.move(1.0), "run": lambda: self.move(5.0)}[task]()
        )
