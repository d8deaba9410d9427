"""The page of teleoperation as a ``Teleoperator`` of LeRobot: ``--teleop.type=roboverse_browser``."""

from roboverse_learn.teleoperation.lerobot.browser import RoboVerseBrowser, RoboVerseBrowserConfig

__all__ = ["RoboVerseBrowser", "RoboVerseBrowserConfig"]
