"""LeRobot's processors of ``keypoint_diffusion``: those of its Diffusion Policy."""

from typing import Any

from lerobot.policies.diffusion.processor_diffusion import make_diffusion_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from torch import Tensor

from policies.diffusion.configuration_keypoint_diffusion import KeypointDiffusionConfig


def make_keypoint_diffusion_pre_post_processors(
    config: KeypointDiffusionConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[PolicyProcessorPipeline[Any, Any], PolicyProcessorPipeline[Any, Any]]:
    """Returns the pipelines that normalize inputs and restore actions."""
    return make_diffusion_pre_post_processors(config, dataset_stats)
