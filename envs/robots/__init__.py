"""Robots: one file each, constants with their sources, no logic."""

from envs.core.registry import Registry
from envs.scenario import RobotCfg

ROBOTS: Registry[RobotCfg] = Registry("robot", group="roboverse.robots")
ROBOTS.add("franka", "envs.robots.franka:FRANKA", summary="Franka Emika Panda with its parallel gripper")
ROBOTS.add("h1", "envs.robots.h1:H1", extra="humanoid", summary="Unitree H1, a humanoid without hands")
ROBOTS.add(
    "sawyer", "envs.robots.sawyer:SAWYER", extra="metaworld", summary="Rethink Sawyer with a parallel gripper"
)
ROBOTS.add("ant", "envs.robots.ant:ANT", summary="a ball on four legs of two joints")
ROBOTS.add("cartpole", "envs.robots.cartpole:CARTPOLE", summary="a free pole on a cart on a rail")
