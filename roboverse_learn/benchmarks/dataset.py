"""Writing and reading of datasets, compared with LeRobot's own writer and loader on the same frames."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmark.throughput import Measurement
from roboverse_learn.data.schema import ACTION_KEY, IMAGE_PREFIX, STATE_KEY, EpisodeData, make_features

NUM_EPISODES, NUM_FRAMES, SIZE, NUM_JOINTS, FPS = 2, 100, 256, 9, 20
BATCH_SIZE, CHUNK = 16, 100
CAMERA = "front"


def measure_write() -> Measurement:
    """Compares writing of the same episodes; each writer ends with a complete, readable dataset.

    Returns:
        Seconds per frame; the ratio is LeRobot's time over ours.
    """
    episodes = _episodes()
    with tempfile.TemporaryDirectory() as folder:
        ours = _timed(_write_ours, Path(folder) / "ours", episodes)
        theirs = _timed(_write_stock, Path(folder) / "stock", episodes)
    frames = NUM_EPISODES * NUM_FRAMES
    return Measurement(
        name=f"dataset write, {SIZE}×{SIZE}, LeRobot / ours",
        ours_s=ours / frames,
        baseline_s=theirs / frames,
        ratio=theirs / ours,
        goal="goal ≥ 3",
    )


def measure_read(turns: int = 5) -> Measurement:
    """Compares the same random batches of one dataset: pictures, states and chunks of actions.

    Args:
        turns: Batches of LeRobot's loader, after one that opens the video; ours gives ten times as many.

    Returns:
        Seconds per sample; the ratio is LeRobot's time over ours.
    """
    from roboverse_learn.data.reader import ResidentDataset

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "ours"
        _write_ours(root, _episodes())
        dataset, stock = ResidentDataset(root), _stock_batches(root)
        deltas = {ACTION_KEY: list(range(CHUNK))}
        rng = np.random.default_rng(0)
        mine, theirs = [], []
        for turn in range(turns + 1):
            started = time.perf_counter()
            next(stock)
            theirs.append(time.perf_counter() - started)
            started = time.perf_counter()
            for _ in range(10):
                dataset.sample(rng.integers(len(dataset), size=BATCH_SIZE), deltas)
            mine.append((time.perf_counter() - started) / 10)
            if turn == 0:
                mine, theirs = [], []
    return Measurement(
        name=f"training read, {SIZE}×{SIZE}, LeRobot / ours",
        ours_s=median(mine) / BATCH_SIZE,
        baseline_s=median(theirs) / BATCH_SIZE,
        ratio=median(theirs) / median(mine),
        goal="goal ≥ 10",
    )


def _episodes() -> list[EpisodeData]:
    """Smooth moving pictures with sensor noise, which no codec compresses to nothing."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 6, SIZE), np.linspace(0, 6, SIZE))
    episodes = []
    for _ in range(NUM_EPISODES):
        phase = np.arange(NUM_FRAMES)[:, None, None] / 10
        plain = 128 + 80 * np.stack([np.sin(x + phase), np.sin(y - phase), np.sin(x + y + phase)], axis=-1)
        noisy = plain + rng.normal(0, 4, plain.shape)
        numbers = rng.normal(size=(2, NUM_FRAMES, NUM_JOINTS)).astype(np.float32)
        episodes.append(
            EpisodeData(
                states=numbers[0],
                actions=numbers[1],
                images={CAMERA: noisy.clip(0, 255).astype(np.uint8)},
                task="benchmark",
                metadata={"episode": len(episodes)},
            )
        )
    return episodes


def _features() -> dict[str, Any]:
    joints = [f"joint{index}" for index in range(NUM_JOINTS)]
    return make_features(joints, joints, {CAMERA: (SIZE, SIZE)})


def _write_ours(root: Path, episodes: list[EpisodeData]) -> None:
    from roboverse_learn.data.writer import DatasetWriter

    with DatasetWriter(root, fps=FPS, features=_features()) as writer:
        for episode in episodes:
            writer.add_episode(episode)


def _write_stock(root: Path, episodes: list[EpisodeData]) -> None:
    """LeRobot's writer as it comes."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {key: {**value, "shape": tuple(value["shape"])} for key, value in _features().items()}
    dataset = LeRobotDataset.create("local/stock", fps=FPS, features=features, root=root)
    for episode in episodes:
        for row in range(episode.length):
            frame = {STATE_KEY: episode.states[row], ACTION_KEY: episode.actions[row], "task": episode.task}
            dataset.add_frame(frame | {IMAGE_PREFIX + CAMERA: episode.images[CAMERA][row]})
        dataset.save_episode()
    dataset.finalize()


def _stock_batches(root: Path) -> Iterator[Any]:
    """LeRobot's dataset behind torch's loader, decoding with the backend that needs no system package."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import DataLoader

    deltas = {ACTION_KEY: [step / FPS for step in range(CHUNK)]}
    dataset = LeRobotDataset("local/ours", root=root, delta_timestamps=deltas, video_backend="pyav")
    while True:
        yield from DataLoader(dataset, batch_size=BATCH_SIZE, shuffle=True, drop_last=True)


def _timed(write: Any, root: Path, episodes: list[EpisodeData]) -> float:
    """Writes once to warm up (imports, codecs) and once on the clock."""
    write(root.with_name(f"{root.name}-warm"), episodes[:1])
    started = time.perf_counter()
    write(root, episodes)
    return time.perf_counter() - started
