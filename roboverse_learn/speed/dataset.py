"""Writing demonstrations and reading training batches, against LeRobot: ``roboverse speed dataset``.

Both sides do all of their work on the same frames: encoding, statistics, metadata, fsync. LeRobot writes
with its defaults (PNG files, then SVT-AV1) and, as the stricter comparison, with its streaming encoder at
our codec settings. Batches are those of an ACT training step: images, state, a chunk of 100 actions, in the
same random order, one thread each, from the same dataset.
"""

import itertools
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import DatasetError
from envs.core.machine import scheduling_kept
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.schema import IMAGE_PREFIX, EpisodeData, make_features
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.dataset.writer import DatasetWriter
from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

FPS, CHUNK_SIZE, TASK = 20, 100, "lift the cube"
CAMERA = IMAGE_PREFIX + "front"
WRITE_GOAL, READ_GOAL, BUSY_GOAL = Goal(3.0), Goal(10.0), Goal(0.4)
_THREADS = _BUSY_PROCESSES = 2


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasetSettings(Settings):
    """Compares writing and reading a dataset to LeRobot.

    Attributes:
        parts: write, write_streaming, read, read_busy (two threads beside two processes that compute all the
            time, against the same without them).
        episodes: Episodes that are written.
        length: Frames of each.
        size: Height and width of a frame, pixels.
        batch_size: Frames of a batch that is read.
        batches: Batches of one turn.
        turns: How often each side is timed, after one turn that warms up.
        out: JSON file for the measurements.
    """

    episodes: int = 3
    length: int = 100
    size: int = 256
    batch_size: int = 16
    batches: int = 20
    turns: int = 1


def parts(settings: DatasetSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    logging.disable(logging.WARNING)  # of the encoders
    return {
        "write": partial(measure_write, settings, "defaults", WRITE_GOAL),
        "write_streaming": partial(measure_write, settings, "streaming", Goal(), streaming=True),
        "read": partial(measure_read, settings),
        "read_busy": partial(measure_read_busy, settings),
    }


def measure_write(
    settings: DatasetSettings, name: str, goal: Goal, *, streaming: bool = False
) -> Measurement:
    """Compares both writers on the same frames, in seconds per frame.

    Args:
        settings: How much is written.
        name: Of LeRobot's encoder.
        goal: Of the speed-up.
        streaming: Whether LeRobot takes its streaming encoder, with our codec settings.
    """
    from lerobot.configs.video import RGBEncoderConfig

    options: dict[str, Any] = {}
    if streaming:
        ours = EncoderConfig()
        codec = RGBEncoderConfig(vcodec="h264", preset=ours.preset, crf=ours.crf, g=ours.gop_size)
        # The queue holds an episode: a full one drops frames.
        options = {"streaming_encoding": True, "encoder_queue_maxsize": 10_000, "rgb_encoder": codec}
    episodes = _episodes(settings)
    with tempfile.TemporaryDirectory() as scratch:
        folders = (Path(scratch) / str(number) for number in itertools.count())
        seconds = in_turns(
            lambda: write_ours(next(folders), episodes),
            lambda: write_lerobot(next(folders), episodes, **options),
            settings.turns,
        )
    num_frames = settings.episodes * settings.length
    return measurement(f"writing a frame, LeRobot ({name}) / ours", seconds, goal, units=num_frames)


def measure_read(settings: DatasetSettings) -> Measurement:
    """Compares both readers on the same batches of one dataset, in seconds per sample.

    Raises:
        DatasetError: if the two read different values.
    """
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    torch.set_num_threads(1)
    size, count = settings.batch_size, settings.batches
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "dataset"
        write_ours(root, _episodes(settings))
        started = time.perf_counter()
        resident = ResidentDataset(root)
        decoding_s = time.perf_counter() - started
        shape = (1 + (settings.turns + 1) * count, size)
        order = np.random.default_rng(0).integers(0, len(resident), shape)
        stamps = {"action": [i / FPS for i in range(CHUNK_SIZE)]}
        stock = LeRobotDataset(
            "roboverse/speed", root=root, video_backend="pyav", delta_timestamps=stamps, return_uint8=True
        )
        theirs = iter(torch.utils.data.DataLoader(stock, batch_sampler=order.tolist(), num_workers=0))
        ours = (resident.sample(indices, {"action": range(CHUNK_SIZE)}) for indices in order)
        _check_equal(next(ours), next(theirs))
        seconds = in_turns(partial(_take, ours, count), partial(_take, theirs, count), settings.turns)
    name = f"reading a sample, batches of {size}, LeRobot / ours (decoded beforehand in {decoding_s:.2f} s)"
    return measurement(name, seconds, READ_GOAL, units=count * size)


def measure_read_busy(settings: DatasetSettings) -> Measurement:
    """Compares our reader on two threads, beside two processes that compute all the time, to itself alone."""
    import psutil
    import torch

    size, count = settings.batch_size, settings.batches
    before = torch.get_num_threads()
    torch.set_num_threads(_THREADS)
    busy = [
        psutil.Popen([sys.executable, "-c", "while True: pass"], stdout=subprocess.DEVNULL)
        for _ in range(_BUSY_PROCESSES)
    ]
    try:
        for process in busy:
            process.suspend()
        with tempfile.TemporaryDirectory() as scratch:
            write_ours(Path(scratch) / "dataset", _episodes(settings))
            resident = ResidentDataset(Path(scratch) / "dataset")
        order = np.random.default_rng(0).integers(0, len(resident), (count, size))

        def alone() -> None:
            for indices in order:
                resident.sample(indices, {"action": range(CHUNK_SIZE)})

        def beside() -> None:
            for process in busy:
                process.resume()
            alone()
            for process in busy:
                process.suspend()

        seconds = in_turns(beside, alone, settings.turns)
    finally:
        torch.set_num_threads(before)
        for process in busy:
            process.kill()
            process.wait()
    name = f"reading a sample, {_THREADS} threads, alone / beside {_BUSY_PROCESSES} busy processes"
    return measurement(name, seconds, BUSY_GOAL, units=count * size)


def _take(batches: Any, count: int) -> None:
    for _ in itertools.islice(batches, count):
        pass


def _check_equal(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    for key, values in ours.items():
        if not values.equal(theirs[key]):
            raise DatasetError(f"The readers disagree on '{key}'. Do not compare their speed.")


def _episodes(settings: DatasetSettings) -> list[EpisodeData]:
    return [synthetic_episode(i, settings.length, settings.size) for i in range(settings.episodes)]


def synthetic_episode(index: int, length: int, size: int) -> EpisodeData:
    """Returns an episode whose images cost an encoder about as much as rendered ones.

    They have a shaded background, moving squares, and the sensor noise of one ray per pixel.

    Args:
        index: Seed of the noise and the paths.
        length: Frames.
        size: Height and width, pixels.
    """
    rng = np.random.default_rng(index)
    y, x = np.mgrid[0:size, 0:size] * (256 / size)
    waves = (120 + 60 * np.sin(x / 40), 110 + 50 * np.cos(y / 55), 90 + 40 * np.sin((x + y) / 70))
    background = np.stack(waves, axis=-1) + rng.normal(0, 4, (size, size, 3))
    images = np.repeat(background.clip(0, 255).astype(np.uint8)[None], length, axis=0)
    half = size // 14
    for t, k in itertools.product(range(length), range(4)):
        column = int(size / 2 + size * 0.31 * np.sin(t / 20 + k + index))
        row = int(size / 2 + size * 0.31 * np.cos(t / 25 + 2 * k))
        color = (40 * k + 30, 200 - 30 * k, 90)
        images[t, row - half : row + half, column - half : column + half] = color
    return EpisodeData(
        states=rng.normal(size=(length, 9)).astype(np.float32),
        actions=rng.normal(size=(length, 9)).astype(np.float32),
        images={"front": images},
        task=TASK,
        raw={"qpos": rng.normal(size=(length + 1, 16)), "ctrl": rng.normal(size=(length, 9))},
        metadata={"episode": index},
    )


def _features(episode: EpisodeData) -> dict[str, Any]:
    height, width = episode.images["front"].shape[1:3]
    states, actions = ([f"{letter}{i}" for i in range(9)] for letter in "qu")
    return make_features(states, actions, {"front": (height, width)})


def write_ours(root: Path, episodes: Sequence[EpisodeData]) -> None:
    """Writes with our writer."""
    with DatasetWriter(root, fps=FPS, features=_features(episodes[0])) as writer:
        for episode in episodes:
            writer.add_episode(episode)


def write_lerobot(root: Path, episodes: Sequence[EpisodeData], **options: Any) -> None:
    """Writes with LeRobot's writer."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = _features(episodes[0])
    for feature in features.values():
        feature["shape"] = tuple(feature["shape"])
    dataset = LeRobotDataset.create("roboverse/speed", fps=FPS, features=features, root=root, **options)
    with scheduling_kept():
        for episode in episodes:
            for t in range(episode.length):
                frame = {"observation.state": episode.states[t], "action": episode.actions[t], "task": TASK}
                dataset.add_frame(frame | {CAMERA: episode.images["front"][t]})
            dataset.save_episode()
        dataset.finalize()


if __name__ == "__main__":
    sys.exit(program("dataset", DatasetSettings, parts))
