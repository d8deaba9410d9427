"""Frames of one or of several datasets, gathered by index into batches.

Which frames a batch takes is computed on the host, for they are few numbers, and sent to the device in one
copy: there, each operation on a few numbers takes as long as one on many.

Shape legend: N = frames, B = batch, T = time steps of a window, C, H, W = image.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.on_device import all_sent, taken

if TYPE_CHECKING:
    import torch


class _Rows(NamedTuple):
    """Frames that a batch takes, (B,) without a window and (B, T) with one.

    Attributes:
        host: Counted over all datasets.
        device: The same on the device.
        own: On the device, counted in the dataset of each.
        is_pad: On the device, whether each is outside its episode; None without a window.
    """

    host: np.ndarray
    device: "torch.Tensor"
    own: "torch.Tensor"
    is_pad: "torch.Tensor | None"


class FrameTable:
    """The frames of datasets, one dataset after the other.

    Args:
        columns: Tensor (N, ...) by key, on the device.
        images: Tensors (N_k, C, H, W) of the datasets by camera, each on the device or in main memory.
        starts: First frame of each frame's episode (N,).
        ends: One past its last frame (N,).
        firsts: First frame of each dataset, and the number of all frames.
        device: Where batches are wanted.
    """

    def __init__(
        self,
        columns: "Mapping[str, torch.Tensor]",
        images: "Mapping[str, Sequence[torch.Tensor]]",
        *,
        starts: np.ndarray,
        ends: np.ndarray,
        firsts: np.ndarray,
        device: "torch.device",
    ) -> None:
        self._columns, self._images = columns, images
        self._starts, self._ends, self._firsts = starts, ends, firsts
        self._device = device

    def sample(
        self,
        indices: "np.ndarray | torch.Tensor | Sequence[int]",
        delta_indices: Mapping[str, Sequence[int]] | None = None,
        *,
        keys: Sequence[str] | None = None,
        channels_last: bool = False,
    ) -> "dict[str, torch.Tensor]":
        """Gathers a batch; see :meth:`roboverse_learn.data.dataset.reader.ResidentDataset.sample`."""
        held = [*self._columns, *self._images]
        deltas = {key: tuple(window) for key, window in (delta_indices or {}).items()}
        wanted = held if keys is None else list(keys)
        if unknown := sorted({*wanted, *deltas} - {*held}):
            raise DatasetError(f"Unknown features {unknown}. Held are {sorted(held)}.")
        index = np.asarray(indices, np.int64).reshape(-1)
        if len(index) and (index.min() < 0 or index.max() >= self._firsts[-1]):
            raise DatasetError(f"Frame indices go from 0 to {self._firsts[-1] - 1}; given {indices}.")
        part = np.searchsorted(self._firsts, index, side="right") - 1
        order = np.argsort(part, kind="stable")
        part = part[order]
        rows = self._rows(index[order], part, [deltas.get(key) for key in wanted])
        batch: dict[str, torch.Tensor] = {}
        for key in wanted:
            own = rows[deltas.get(key)]
            if key in self._columns:
                batch[key] = taken(self._columns[key], own.host, own.device, self._device)
            else:
                images = self._gather(self._images[key], own, part)
                batch[key] = images.movedim(-3, -1) if channels_last else images
            if own.is_pad is not None:
                batch[f"{key}_is_pad"] = own.is_pad
        if (np.diff(order) > 0).all():  # as a sampler of one dataset, or a balanced one, gives them
            return batch
        (back,) = all_sent([np.argsort(order)], self._device)
        return {key: values[back] for key, values in batch.items()}

    def _rows(
        self, index: np.ndarray, part: np.ndarray, windows: Sequence[tuple[int, ...] | None]
    ) -> dict[tuple[int, ...] | None, _Rows]:
        """Returns what each window around frames (B,) of datasets (B,) takes."""
        firsts = self._firsts[part]
        numbers: dict[tuple[int, ...] | None, list[np.ndarray]] = {}
        for window in dict.fromkeys(windows):
            if window is None:
                numbers[window] = [index, index - firsts]
            else:
                frames, is_pad = clamp_window(index, window, self._starts[index], self._ends[index])
                numbers[window] = [frames, frames - firsts[:, None], is_pad.astype(np.int64)]
        sent = iter(all_sent([each for arrays in numbers.values() for each in arrays], self._device))
        return {
            window: _Rows(arrays[0], next(sent), next(sent), None if window is None else next(sent).bool())
            for window, arrays in numbers.items()
        }

    def _gather(self, datasets: "Sequence[torch.Tensor]", rows: _Rows, part: np.ndarray) -> "torch.Tensor":
        """Gathers images (B, ...) or (B, T, ...) of datasets (B,), which are sorted."""
        import torch

        if len(datasets) == 1:
            return taken(datasets[0], rows.host, rows.own, self._device)
        bounds = np.searchsorted(part, np.arange(len(datasets) + 1)).tolist()
        return torch.cat(
            [
                taken(frames, rows.host[first:last] - offset, rows.own[first:last], self._device)
                for frames, offset, first, last in zip(
                    datasets, self._firsts[:-1], bounds[:-1], bounds[1:], strict=True
                )
            ]
        )


def clamp_window(
    index: np.ndarray, window: Sequence[int], starts: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the frames of a window around each index, kept inside the index's episode.

    Args:
        index: (B,) frames.
        window: T offsets.
        starts: (B,) first frame of each index's episode.
        ends: (B,) one past its last frame.

    Returns:
        Frames (B, T) and whether each is outside the episode (B, T).
    """
    rows = index[:, None] + np.asarray(window, np.int64)
    is_pad = (rows < starts[:, None]) | (rows >= ends[:, None])
    return np.clip(rows, starts[:, None], ends[:, None] - 1), is_pad
