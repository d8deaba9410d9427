"""Registers ``--env.type=roboverse`` and the policy types ``keypoint_act`` and ``multitask_act``.

LeRobot imports this module by its name.
"""

import envs.lerobot  # noqa: F401
import policies.act.configuration_keypoint_act
import policies.mtact.configuration_multitask_act  # noqa: F401
