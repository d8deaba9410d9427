"""A dataset held decoded in memory, from which training batches are gathered by index.

LeRobot's loader seeks and decodes video for every sample. Demonstrations of one task fit in memory (an
episode of 100 frames at 128x128 takes 5 MB), so each frame is decoded once, and a batch is one gather.

Shape legend: N = frames of the dataset, B = batch, T = time steps of a window, C, H, W = image.
"""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envs.core.errors import DatasetError
from envs.core.machine import num_cores
from roboverse_learn.data.dataset.decoders import Decoders
from roboverse_learn.data.dataset.frame_table import FrameTable
from roboverse_learn.data.dataset.images import load_images
from roboverse_learn.data.dataset.info import DatasetInfo

if TYPE_CHECKING:
    import torch

_LOG = logging.getLogger(__name__)

TRAINING_BYTES = 20_000_000_000
"""Of a GPU, what images leave to training at least if they take more than their share of it.

Policies of the recipes take 3 to 10 GB.
"""


class ResidentDataset:
    """All frames of a LeRobotDataset v3, of any writer, ready to be gathered.

    Images that would take more than ``memory_fraction`` of the free memory go to a memory-mapped file in
    the dataset's ``.cache`` folder instead, written once.

    Args:
        root: The dataset's folder, or its metadata if they are read already.
        keys: Features to hold; all by default.
        device: Where batches are wanted. Images are moved there for good if they fit into
            ``memory_fraction`` of its free memory or leave :data:`TRAINING_BYTES` of it; else each batch is.
        memory_fraction: Share of free memory that images may take, in (0, 1].
        num_threads: Decoding threads; one per core by default.
        decoders: Processes that decode several datasets, one after the other; by default each has its own.

    Attributes:
        info: The dataset's metadata.
        frames: Tensor by key; numeric (N,) or (N, D), images uint8 (N, C, H, W).

    Raises:
        DatasetError: The dataset is absent, truncated or damaged; the message names the file.
    """

    def __init__(
        self,
        root: str | Path | DatasetInfo,
        *,
        keys: Sequence[str] | None = None,
        device: "str | torch.device" = "cpu",
        memory_fraction: float = 0.5,
        num_threads: int | None = None,
        decoders: Decoders | None = None,
    ) -> None:
        import torch

        self.info = root if isinstance(root, DatasetInfo) else DatasetInfo.open(root)
        self.device = torch.device(device)
        chosen = _chosen_features(self.info, keys)
        cameras = [key for key in chosen if key in self.info.camera_keys]
        columns = self.info.read_columns([key for key in chosen if key not in cameras])
        images = load_images(self.info, cameras, memory_fraction, num_threads or num_cores(), decoders)
        held = {key: torch.from_numpy(array) for key, array in images.items()}
        if self.device.type == "cpu" or self._fit_on_device(held, memory_fraction):
            held = {key: frames.to(self.device) for key, frames in held.items()}
        numbers = {key: torch.from_numpy(array).to(self.device) for key, array in columns.items()}
        self.frames: dict[str, torch.Tensor] = {**numbers, **held}
        lengths = self.info.episode_lengths
        self._table = FrameTable(
            numbers,
            {key: [frames] for key, frames in held.items()},
            starts=np.repeat(self.info.episode_starts, lengths),
            ends=np.repeat(self.info.episode_ends, lengths),
            firsts=np.array([0, self.info.num_frames]),
            device=self.device,
        )

    def __len__(self) -> int:
        """Number of frames."""
        return self.info.num_frames

    def sample(
        self,
        indices: "np.ndarray | torch.Tensor | Sequence[int]",
        delta_indices: Mapping[str, Sequence[int]] | None = None,
        *,
        keys: Sequence[str] | None = None,
        channels_last: bool = False,
    ) -> "dict[str, torch.Tensor]":
        """Gathers a batch, as LeRobot's dataset and default collation would.

        Args:
            indices: Frames (B,), counted over the whole dataset.
            delta_indices: Window per key, in frames relative to the index, such as
                ``{"action": range(20)}``. Outside the episode the nearest frame of it is repeated, and
                ``<key>_is_pad`` (B, T) is true there.
            keys: Features wanted; all that are held by default.
            channels_last: Whether images come as (..., H, W, C).

        Returns:
            Tensors on :attr:`device`: (B, ...) without a window, (B, T, ...) with one; images uint8
            (B, [T,] C, H, W).

        Raises:
            DatasetError: A key is unknown or an index is outside the dataset.
        """
        return self._table.sample(indices, delta_indices, keys=keys, channels_last=channels_last)

    def _fit_on_device(self, images: "Mapping[str, torch.Tensor]", memory_fraction: float) -> bool:
        """Whether the device has room for images, for good."""
        import torch

        if self.device.type != "cuda":
            return True
        num_bytes = sum(frames.nbytes for frames in images.values())
        free = torch.cuda.mem_get_info(self.device)[0]
        fit = num_bytes <= max(memory_fraction * free, free - TRAINING_BYTES)
        if not fit:
            _LOG.warning(
                "The images (%.1f GB) stay in main memory: %s has %.1f GB free.",
                num_bytes / 1e9,
                self.device,
                free / 1e9,
            )
        return fit


def _chosen_features(info: DatasetInfo, keys: Sequence[str] | None) -> list[str]:
    """Returns the features to hold."""
    if keys is None:
        return [key for key, feature in info.features.items() if feature["dtype"] != "string"]
    unknown = sorted(set(keys) - set(info.features))
    if unknown:
        raise DatasetError(f"The dataset '{info.root}' has no {unknown}. It has {sorted(info.features)}.")
    return list(keys)
