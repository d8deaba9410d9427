"""Example robot: a Franka Panda on a block of 10 cm."""

from dataclasses import replace

from envs.robots.franka import FRANKA

FRANKA_ON_BLOCK = replace(FRANKA, name="franka_on_block", pos=(-0.615, 0.0, 0.1))
"""The base is where ManiSkill's table-top tasks have it, 0.1 m higher; pose in the world frame, m."""
