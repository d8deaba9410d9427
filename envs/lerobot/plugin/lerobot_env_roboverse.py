"""Registers the env, robot and teleoperators ``roboverse``, and our policy types.

These are ``keypoint_act``, ``keypoint_diffusion`` and ``multitask_act``. LeRobot imports this module by its
name.
"""

import envs.lerobot  # noqa: F401
import policies.act.configuration_keypoint_act
import policies.diffusion.configuration_keypoint_diffusion
import policies.mtact.configuration_multitask_act  # noqa: F401
import roboverse_learn.teleoperation.lerobot  # noqa: F401
