"""LeRobot's processors of ``keypoint_act``."""

from typing import Any

from lerobot.processor import PolicyProcessorPipeline, make_default_pre_post_processors
from torch import Tensor

from policies.act.configuration_keypoint_act import KeypointActConfig


def make_keypoint_act_pre_post_processors(
    config: KeypointActConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[PolicyProcessorPipeline[Any, Any], PolicyProcessorPipeline[Any, Any]]:
    """Returns the pipelines that normalize inputs and restore actions."""
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
