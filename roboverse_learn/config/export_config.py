"""Configuration of ``roboverse export``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportConfig:
    """``roboverse export``: a checkpoint as a folder that ``lerobot-rollout`` runs on a real robot.

    Attributes:
        checkpoint: Run, or a checkpoint of it.
        to: Robot of LeRobot's (``--robot.type``); the one that the checkpoint's data have the units of.
        out: Folder to write to; empty for exports/<robot>/<run>.
    """

    checkpoint: str = ""
    to: str = "so101_follower"
    out: str = ""
