"""The last pictures of all cameras, as one: what a policy that learns by reward sees of pixels."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from policies.base import Observation, PolicyError


def stacked(observation: Observation, sizes: Mapping[str, int], num_frames: int, policy: str) -> Tensor:
    """Returns pictures as channels: frame after frame, the oldest first, and in each camera after camera.

    Args:
        observation: Pictures (n, num_frames, size, size, 3) uint8 by key; (n, size, size, 3) of one frame.
        sizes: Keys that the policy sees, in order, and the pixels a side of their pictures.
        num_frames: F.
        policy: Its name, for messages.

    Returns:
        (n, F × cameras × 3, size, size) uint8, on the CPU.

    Raises:
        PolicyError: if a camera is absent, or its pictures are of another shape or kind.
    """
    cameras = []
    for key, size in sizes.items():
        if key not in observation:
            raise PolicyError(
                f"The observation has no '{key}', which policy '{policy}' needs. "
                f"Given: {', '.join(sorted(observation)) or 'nothing'}. Use the cameras that it was "
                "trained with."
            )
        pictures = np.asarray(observation[key])
        expected = (*((num_frames,) if num_frames > 1 else ()), size, size, 3)
        if pictures.dtype != np.uint8 or pictures.shape[1:] != expected:
            raise PolicyError(
                f"'{key}' is {pictures.dtype} of shape {pictures.shape}, but policy '{policy}' was made for "
                f"uint8 of shape (n, {', '.join(map(str, expected))}). Use the image_size that it was "
                "trained with."
            )
        cameras.append(torch.from_numpy(pictures).view(len(pictures), num_frames, size, size, 3))
    frames = torch.cat(cameras, dim=-1)  # (n, F, size, size, cameras × 3)
    return frames.permute(0, 1, 4, 2, 3).flatten(1, 2).contiguous()
