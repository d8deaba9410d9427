"""The channels of randomization, the levels made of them, and their frozen splits.

Names are imported at first use: importing this package costs NumPy and nothing else.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from envs.randomization.camera_poses import CAMERA_POSES, CameraPose, place_camera
    from envs.randomization.channels import CHANNELS, Channel, Scene, divided
    from envs.randomization.levels import LEVEL_CHANNELS, LEVELS, NAMED_LEVELS, channels_of, parse_level
    from envs.randomization.lights import temperature_to_rgb
    from envs.randomization.materials import MaterialLibrary
    from envs.randomization.procedural import texture
    from envs.randomization.randomizer import Randomizer
    from envs.randomization.seeding import channel_rng
    from envs.randomization.splits import SPLITS, Split, load_split
    from envs.scenario import LightingCfg

_HOMES = {
    "CAMERA_POSES": "camera_poses",
    "CameraPose": "camera_poses",
    "place_camera": "camera_poses",
    "CHANNELS": "channels",
    "Channel": "channels",
    "Scene": "channels",
    "divided": "channels",
    "LEVEL_CHANNELS": "levels",
    "LEVELS": "levels",
    "NAMED_LEVELS": "levels",
    "channels_of": "levels",
    "parse_level": "levels",
    "LightingCfg": "lights",
    "temperature_to_rgb": "lights",
    "MaterialLibrary": "materials",
    "texture": "procedural",
    "Randomizer": "randomizer",
    "channel_rng": "seeding",
    "SPLITS": "splits",
    "Split": "splits",
    "load_split": "splits",
}

__all__ = [
    "CAMERA_POSES",
    "CHANNELS",
    "LEVELS",
    "LEVEL_CHANNELS",
    "NAMED_LEVELS",
    "SPLITS",
    "CameraPose",
    "Channel",
    "LightingCfg",
    "MaterialLibrary",
    "Randomizer",
    "Scene",
    "Split",
    "channel_rng",
    "channels_of",
    "divided",
    "load_split",
    "parse_level",
    "place_camera",
    "temperature_to_rgb",
    "texture",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
