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
from roboverse_learn.data.dataset.images import load_images
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.on_device import constant, sent

if TYPE_CHECKING:
    import torch

_LOG = logging.getLogger(__name__)


class ResidentDataset:
    """All frames of a LeRobotDataset v3, of any writer, ready to be gathered.

    Images that would take more than ``memory_fraction`` of the free memory go to a memory-mapped file in
    the dataset's ``.cache`` folder instead, written once.

    Args:
        root: The dataset's folder.
        keys: Features to hold; all by default.
        device: Where batches are wanted. Frames are moved there for good if they fit into
            ``memory_fraction`` of its free memory; else each batch is.
        memory_fraction: Share of free memory that images may take, in (0, 1].
        num_threads: Decoding threads; one per core by default.

    Attributes:
        info: The dataset's metadata.
        frames: Tensor by key; numeric (N,) or (N, D), images uint8 (N, C, H, W).

    Raises:
        DatasetError: The dataset is absent, truncated or damaged; the message names the file.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        keys: Sequence[str] | None = None,
        device: "str | torch.device" = "cpu",
        memory_fraction: float = 0.5,
        num_threads: int | None = None,
    ) -> None:
        import torch

        self.info = DatasetInfo.open(root)
        self.device = torch.device(device)
        chosen = _chosen_features(self.info, keys)
        cameras = [key for key in chosen if key in self.info.camera_keys]
        columns = self.info.read_columns([key for key in chosen if key not in cameras])
        images = load_images(self.info, cameras, memory_fraction, num_threads or num_cores())
        self.frames: dict[str, torch.Tensor] = {
            key: torch.from_numpy(array) for key, array in {**columns, **images}.items()
        }
        lengths = self.info.episode_lengths
        self._starts = torch.from_numpy(np.repeat(self.info.episode_starts, lengths))
        self._ends = torch.from_numpy(np.repeat(self.info.episode_ends, lengths))
        if self.device.type != "cpu":
            self._move(memory_fraction)

    def __len__(self) -> int:
        """Number of frames."""
        return self.info.num_frames

    @property
    def num_bytes(self) -> int:
        """Memory that the frames take."""
        return sum(frames.nbytes for frames in self.frames.values())

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
        import torch

        deltas = {key: list(window) for key, window in (delta_indices or {}).items()}
        wanted = list(self.frames) if keys is None else list(keys)
        unknown = sorted({*wanted, *deltas} - set(self.frames))
        if unknown:
            raise DatasetError(f"Unknown features {unknown}. Held are {sorted(self.frames)}.")
        index = torch.as_tensor(indices, dtype=torch.int64).reshape(-1)
        if len(index) and (int(index.min()) < 0 or int(index.max()) >= len(self)):
            raise DatasetError(f"Frame indices go from 0 to {len(self) - 1}; given {indices}.")
        index = sent(index, self._starts.device)
        batch: dict[str, torch.Tensor] = {}
        windows: dict[tuple[int, ...], tuple[torch.Tensor, torch.Tensor]] = {}
        for key in wanted:
            if key not in deltas:
                batch[key] = self._gather(key, index, channels_last)
                continue
            window = tuple(deltas[key])
            if window not in windows:
                windows[window] = clamp_window(index, window, self._starts[index], self._ends[index])
            rows, is_pad = windows[window]
            batch[key] = self._gather(key, rows, channels_last)
            batch[f"{key}_is_pad"] = is_pad.to(self.device, non_blocking=True)
        return batch

    def _gather(self, key: str, rows: "torch.Tensor", channels_last: bool) -> "torch.Tensor":
        """Gathers rows (B,) or (B, T) of one feature."""
        import torch

        frames = self.frames[key]
        if frames.device.type == "cpu":
            # By one thread, as fast as torch's by two: those wait for each other where cores are busy.
            flat = torch.from_numpy(frames.numpy().take(rows.reshape(-1).cpu().numpy(), axis=0))
        else:
            flat = frames.index_select(0, rows.reshape(-1).to(frames.device))
        values = flat.reshape(*rows.shape, *frames.shape[1:])
        if channels_last and key in self.info.camera_keys:
            values = values.movedim(-3, -1)
        return values.to(self.device, non_blocking=True)

    def _move(self, memory_fraction: float) -> None:
        """Moves the frames to the device for good, if they fit."""
        import torch

        free = torch.cuda.mem_get_info(self.device)[0] if self.device.type == "cuda" else None
        if free is not None and self.num_bytes > memory_fraction * free:
            _LOG.warning(
                "The frames (%.1f GB) stay in main memory: %s has %.1f GB free.",
                self.num_bytes / 1e9,
                self.device,
                free / 1e9,
            )
            return
        self.frames = {key: frames.to(self.device) for key, frames in self.frames.items()}
        self._starts, self._ends = self._starts.to(self.device), self._ends.to(self.device)


def clamp_window(
    index: "torch.Tensor", window: Sequence[int], starts: "torch.Tensor", ends: "torch.Tensor"
) -> "tuple[torch.Tensor, torch.Tensor]":
    """Returns the frames of a window around each index, kept inside the index's episode.

    Args:
        index: (B,) frames.
        window: T offsets.
        starts: (B,) first frame of each index's episode.
        ends: (B,) one past its last frame.

    Returns:
        Frames (B, T) and whether each is outside the episode (B, T).
    """
    import torch

    rows = index[:, None] + constant(tuple(window), torch.int64, index.device)[None, :]
    is_pad = (rows < starts[:, None]) | (rows >= ends[:, None])
    return torch.minimum(torch.maximum(rows, starts[:, None]), ends[:, None] - 1), is_pad


def _chosen_features(info: DatasetInfo, keys: Sequence[str] | None) -> list[str]:
    """Returns the features to hold."""
    if keys is None:
        return [key for key, feature in info.features.items() if feature["dtype"] != "string"]
    unknown = sorted(set(keys) - set(info.features))
    if unknown:
        raise DatasetError(f"The dataset '{info.root}' has no {unknown}. It has {sorted(info.features)}.")
    return list(keys)
