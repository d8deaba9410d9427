"""Registers ``--env.type=roboverse`` and the policy type ``keypoint_act`` with LeRobot.

LeRobot imports this module by its name.
"""

import envs.lerobot  # noqa: F401
import policies.act.configuration_keypoint_act  # noqa: F401
