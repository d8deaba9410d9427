"""Decodes every image of a dataset once, into memory or into a memory-mapped file beside the dataset."""

import hashlib
import io
import logging
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from envs.core.atomic import atomic_path
from envs.core.errors import DatasetError
from envs.core.machine import num_cores
from roboverse_learn.data.dataset.damage import broken_file
from roboverse_learn.data.dataset.decoders import Decoders, VideoJob
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.schema import video_keys
from roboverse_learn.data.dataset.tables import read_parquet
from roboverse_learn.data.dataset.video import check_frames, decode_video
from roboverse_learn.data.free_memory import free_memory_bytes
from roboverse_learn.folder_lock import lock_directory

_LOG = logging.getLogger(__name__)
CACHE_DIRECTORY = ".cache"


def load_images(
    info: DatasetInfo,
    keys: list[str],
    memory_fraction: float,
    num_threads: int,
    decoders: Decoders | None = None,
) -> dict[str, np.ndarray]:
    """Decodes image features.

    Args:
        info: The dataset.
        keys: Image features.
        memory_fraction: Share of the free memory that they may take; beyond it they are memory-mapped.
        num_threads: Files decoded side by side, by processes if they are many and by threads otherwise.
        decoders: Processes to do it, which also decode other datasets; by default there are new ones.

    Returns:
        uint8 (num_frames, C, H, W) by key.

    Raises:
        DatasetError: A video is absent, truncated or damaged, or the disk is full.
    """
    shapes = {key: _resident_shape(info, key) for key in keys}
    in_memory = sum(int(np.prod(shape)) for shape in shapes.values()) <= memory_fraction * free_memory_bytes()
    if not in_memory:
        return {key: _mapped(info, key, shape, num_threads) for key, shape in shapes.items()}
    videos = {key: shape for key, shape in shapes.items() if info.features[key]["dtype"] != "image"}
    images: dict[str, np.ndarray] = {}
    with nullcontext(decoders) if decoders else Decoders(len(videos) * info.num_frames, num_threads) as used:
        if used.count and videos:
            images = used.decode(videos, {key: _video_jobs(info, key) for key in videos})
    for key in shapes.keys() - images.keys():
        images[key] = np.empty(shapes[key], dtype=np.uint8)
        _decode(info, key, images[key], num_threads)
    return {key: images[key] for key in keys}


def damaged_videos(info: DatasetInfo) -> list[DatasetError]:
    """Looks at every video of a dataset, without decoding any: about two milliseconds each.

    Returns:
        An error for each that is absent or damaged, or lacks frames of its episodes; it names the file.
    """
    jobs = [job for key in video_keys(info.features) for job in _video_jobs(info, key)]

    def damage(job: VideoJob) -> DatasetError | None:
        try:
            check_frames(job[0], job[1])
        except DatasetError as error:
            return error
        return None

    with ThreadPoolExecutor(num_cores()) as pool:
        return [error for error in pool.map(damage, jobs) if error is not None]


def _resident_shape(info: DatasetInfo, key: str) -> tuple[int, int, int, int]:
    """Returns (N, C, H, W) of an image feature."""
    feature = info.features[key]
    details = feature.get("info") or {}
    if details.get("is_depth_map") or details.get("video.is_depth_map"):
        raise DatasetError(f"'{key}' is a depth map, which is not 8-bit RGB. Leave it out of `keys`.")
    height, width, channels = feature["shape"]
    if feature["dtype"] == "image" and (feature.get("names") or [""])[0] in ("channel", "channels"):
        channels, height, width = feature["shape"]
    return info.num_frames, channels, height, width


def _decode(info: DatasetInfo, key: str, out: np.ndarray, num_threads: int) -> None:
    """Fills ``out`` (N, C, H, W) with the frames of a feature."""
    if info.features[key]["dtype"] == "image":
        _decode_images(info, key, out)
        return
    jobs = list(_video_jobs(info, key))
    per_video = 1 if len(jobs) >= num_threads else 0
    with ThreadPoolExecutor(num_threads) as pool:
        futures = [pool.submit(decode_video, path, times, rows, out, per_video) for path, times, rows in jobs]
        try:
            for future in futures:
                future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _video_jobs(info: DatasetInfo, key: str) -> Iterator[VideoJob]:
    """Yields each video with the times wanted from it and the frames they are."""
    by_file: dict[Path, list[int]] = {}
    for episode in range(info.num_episodes):
        by_file.setdefault(info.video_file(episode, key), []).append(episode)
    for path, episodes in by_file.items():
        times, rows = [], []
        for episode in episodes:
            start, end = info.episode_starts[episode], info.episode_ends[episode]
            frames = np.arange(end - start)
            times.append(info.episodes[episode][f"videos/{key}/from_timestamp"] + frames / info.fps)
            rows.append(start + frames)
        yield path, np.concatenate(times), np.concatenate(rows)


def _decode_images(info: DatasetInfo, key: str, out: np.ndarray) -> None:
    """Decodes a feature stored as image files inside parquet."""
    from PIL import Image, UnidentifiedImageError

    row = 0
    for path in info.data_files():
        for encoded in read_parquet(path, [key])[key].to_pylist()[: len(out) - row]:
            try:
                image = Image.open(io.BytesIO(encoded["bytes"])).convert("RGB")
            except (UnidentifiedImageError, OSError, TypeError) as error:
                raise broken_file(path, f"the image of frame {row} cannot be decoded") from error
            out[row] = np.asarray(image).transpose(2, 0, 1)
            row += 1
    if row < len(out):
        raise broken_file(info.root / "data", f"'{key}' has {row} of {len(out)} images")


def _mapped(info: DatasetInfo, key: str, shape: tuple[int, ...], num_threads: int) -> np.ndarray:
    """Returns a memory-mapped array of a feature's frames, decoding them the first time."""
    path = info.root / CACHE_DIRECTORY / f"{key}.{_fingerprint(info, key)}.npy"
    if not path.exists():
        # Another process would delete the partial file as one that a killed process left.
        lock = lock_directory(info.root, wait=True)
        try:
            if not path.exists():  # nor did another process decode it in the meantime
                _decode_to_file(info, key, shape, num_threads, path)
        finally:
            lock.release()
    # Copy-on-write, because torch needs writable memory.
    return np.lib.format.open_memmap(path, mode="c")


def _decode_to_file(
    info: DatasetInfo, key: str, shape: tuple[int, ...], num_threads: int, path: Path
) -> None:
    """Decodes a feature's frames to a file, in place of those of the feature as it was before."""
    _LOG.info("Decoding '%s' to %s (%.1f GB).", key, path, np.prod(shape) / 1e9)
    with atomic_path(path) as partial:
        for stale in path.parent.glob(f"{key}.*.npy"):
            stale.unlink()
        out = np.lib.format.open_memmap(partial, mode="w+", dtype=np.uint8, shape=shape)
        # Take the blocks now: a full disk is an error here and a crash in a mapped write.
        if hasattr(os, "posix_fallocate"):
            with open(partial, "r+b") as file:
                os.posix_fallocate(file.fileno(), 0, partial.stat().st_size)
        _decode(info, key, out, num_threads)
        out.flush()


def _fingerprint(info: DatasetInfo, key: str) -> str:
    """Returns a short hash that changes when a feature's frames may have changed."""
    digest = hashlib.sha256(repr((info.num_frames, info.features[key]["shape"])).encode())
    files = info.data_files() if info.features[key]["dtype"] == "image" else None
    for path in dict.fromkeys(files or (info.video_file(e, key) for e in range(info.num_episodes))):
        try:
            status = path.stat()
        except FileNotFoundError as error:
            raise DatasetError(f"'{path}' is missing. Restore it from a copy, or collect again.") from error
        digest.update(f"{path.name}:{status.st_size}:{status.st_mtime_ns}".encode())
    return digest.hexdigest()[:16]
