"""Robots: one file each, constants with their sources, no logic."""

from envs.registry import Registry
from envs.scenario import RobotCfg

ROBOTS: Registry[RobotCfg] = Registry("robot")
ROBOTS.add("franka", "envs.robots.franka:FRANKA", summary="Franka Emika Panda with its parallel gripper")
