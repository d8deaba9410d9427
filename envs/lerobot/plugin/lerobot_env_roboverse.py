"""Registers ``--env.type=roboverse`` with LeRobot, which imports this module by its name."""

import envs.lerobot  # noqa: F401
