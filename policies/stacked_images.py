"""The last images of all cameras, as one: what a reinforcement learning policy sees of pixels."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from policies.base import Observation, observed


def stacked(observation: Observation, sizes: Mapping[str, int], num_frames: int, policy: str) -> Tensor:
    """Returns images as channels: frame after frame, the oldest first, and in each camera after camera.

    Args:
        observation: Images (n, num_frames, size, size, 3) uint8 by key; (n, size, size, 3) of one frame.
        sizes: Keys that the policy sees, in order, and the pixels a side of their images.
        num_frames: F.
        policy: Its name, for messages.

    Returns:
        (n, F × cameras × 3, size, size) uint8, on the CPU.

    Raises:
        PolicyError: if a camera is absent, or its images are of another shape or kind.
    """
    cameras = []
    for key, size in sizes.items():
        shape = (*((num_frames,) if num_frames > 1 else ()), size, size, 3)
        images = observed(observation, key, shape, policy, np.uint8)
        cameras.append(torch.from_numpy(images).view(len(images), num_frames, size, size, 3))
    frames = torch.cat(cameras, dim=-1)  # (n, F, size, size, cameras × 3)
    return frames.permute(0, 1, 4, 2, 3).flatten(1, 2).contiguous()
