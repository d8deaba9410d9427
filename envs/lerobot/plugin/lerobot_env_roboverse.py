"""Registers the env, robot and teleoperators called ``roboverse`` and the policy type ``keypoint_act``.

LeRobot imports this module by its name.
"""

import envs.lerobot  # noqa: F401
import policies.act.configuration_keypoint_act  # noqa: F401
import roboverse_learn.teleoperation.lerobot  # noqa: F401
