"""LeRobot plugin: ``--env.type=roboverse`` for ``lerobot-train`` and ``lerobot-eval``.

LeRobot imports installed distributions called ``lerobot_env_*``; the folder ``plugin`` beside this file
is one, which imports this package. Without it, add ``--env.discover_packages_path=envs.lerobot``.
"""

from envs.lerobot.env import RoboVerseEnvConfig

__all__ = ["RoboVerseEnvConfig"]
