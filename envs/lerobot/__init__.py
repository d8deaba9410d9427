"""LeRobot plugin: ``--env.type=roboverse``, ``--robot.type=roboverse``, ``--teleop.type=roboverse_expert``.

LeRobot imports installed distributions called ``lerobot_env_*``, whichever command runs; the folder
``plugin`` beside this file is one, which imports this package. Without it, add
``--env.discover_packages_path=envs.lerobot``, or ``--robot.`` in place of ``--env.``.
"""

from envs.lerobot.env import RoboVerseEnvConfig
from envs.lerobot.robot import RoboVerseRobot, RoboVerseRobotConfig
from envs.lerobot.teleoperators import (
    RoboVerseExpert,
    RoboVerseExpertConfig,
    RoboVerseReplay,
    RoboVerseReplayConfig,
)

__all__ = [
    "RoboVerseEnvConfig",
    "RoboVerseExpert",
    "RoboVerseExpertConfig",
    "RoboVerseReplay",
    "RoboVerseReplayConfig",
    "RoboVerseRobot",
    "RoboVerseRobotConfig",
]
