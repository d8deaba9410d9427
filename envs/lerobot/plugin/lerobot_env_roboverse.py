"""Registers the env, robot and teleoperators ``roboverse``; policy types ``keypoint_act``, ``multitask_act``.

LeRobot imports this module by its name.
"""

import envs.lerobot  # noqa: F401
import policies.act.configuration_keypoint_act
import policies.mtact.configuration_multitask_act  # noqa: F401
import roboverse_learn.teleoperation.lerobot  # noqa: F401
