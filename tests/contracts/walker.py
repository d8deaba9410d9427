"""A small robot whose base moves freely, on a bare ground: two legs under a trunk."""

from pathlib import Path

import numpy as np
import torch

from envs.scenario import BodyCfg, CameraCfg, JointCfg, PhysicsCfg, RobotCfg, ScenarioCfg, SiteCfg
from envs.state import EntityState, State

MASS_KG = 5.0
"""Of the trunk; the file says another."""


def _leg(name: str) -> JointCfg:
    return JointCfg(
        name=name,
        kp=50.0,
        kd=2.0,
        force_limit=20.0,
        range=(-1.0, 1.0),
        default=0.1,
        damping=0.5,
        armature=0.05,
        target_range=(-0.8, 0.6),
    )


WALKER = RobotCfg(
    name="walker",
    mjcf=str(Path(__file__).with_name("walker.xml")),
    root="trunk",
    joints=(_leg("right"), _leg("left")),
    ee_site="head",
    bodies=(
        BodyCfg(
            name="trunk",
            mass_kg=MASS_KG,
            com=(0.0, 0.01, 0.02),
            inertia=(0.06, 0.05, 0.04),
            inertia_rot=(1.0, 0.0, 0.0, 0.0),
        ),
    ),
    sites=(SiteCfg(name="head", body="trunk", pos=(0.0, 0.0, 0.2)),),
    pos=(0.0, 0.0, 0.45),
    fixed_base=False,
    gravity_compensated=False,
    feels=("ground",),
)

SCENARIO = ScenarioCfg(
    robots=(WALKER,),
    cameras=(CameraCfg(name="front", pos=(2.0, 0.0, 1.0), look_at=(0.0, 0.0, 0.3), width=32, height=32),),
    table=None,
    room=None,
    physics=PhysicsCfg(timestep_s=0.002, decimation=10),
)


def random_states(seed: int, count: int, height_m: float = 1.0) -> State:
    """Random states with the trunk about ``height_m`` above the ground."""
    rng = np.random.default_rng(seed)
    rot = rng.normal(size=(count, 4))
    pos = rng.normal(size=(count, 3)) * 0.2 + [0.0, 0.0, height_m]
    robot = EntityState.at_rest(
        pos, rot / np.linalg.norm(rot, axis=-1, keepdims=True), rng.uniform(-0.5, 0.5, (count, 2))
    )
    robot.lin_vel = torch.from_numpy(rng.normal(size=(count, 3)))
    robot.ang_vel = torch.from_numpy(rng.normal(size=(count, 3)))
    robot.joint_vel = torch.from_numpy(rng.normal(size=(count, 2)))
    robot.joint_target = torch.from_numpy(rng.uniform(-0.5, 0.5, (count, 2)))
    return State({"walker": robot}, {})
