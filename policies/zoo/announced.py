"""The policies of LeRobot's registry, whose import takes so long that it is announced."""

import logging
import sys
from importlib.util import find_spec

if "lerobot.policies" not in sys.modules and find_spec("transformers"):
    logging.getLogger(__name__).info(
        "Importing LeRobot's policies and transformers, for about half a minute."
    )

from policies.zoo.policy import LeRobotZooPolicy

__all__ = ["LeRobotZooPolicy"]
