"""Writing demonstrations and reading training batches, against LeRobot: ``roboverse speed dataset``.

Both sides do all of their work on the same frames: encoding, statistics, metadata, fsync. LeRobot writes
with its defaults (PNG files, then SVT-AV1) and, as the stricter comparison, with its streaming encoder at
our codec settings. Batches are those of an ACT training step: images, state, a chunk of 100 actions, in the
same random order, one thread each, from the same dataset.
"""

import contextlib
import itertools
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, override

import numpy as np

from envs.core.errors import DatasetError
from envs.core.machine import scheduling_kept
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.dataset.writer import DatasetWriter
from roboverse_learn.speed.harness import NO_GOAL, Goal, Measurement, Program, part
from roboverse_learn.speed.training import CAMERA, plain_features
from roboverse_learn.training.device import cpu_threads

FPS, TASK = 20, "lift the cube"
CHUNK = {"action": range(100)}
WRITE_GOAL, READ_GOAL, BUSY_GOAL = Goal(3.0), Goal(10.0), Goal(0.4)
_THREADS = _BUSY_PROCESSES = 2
_BUSY_TIMES = 50
"""As many batches beside busy processes: a turn must last for many time slices of the system's scheduler."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Dataset(Program):
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
    """

    episodes: int = 3
    length: int = 100
    size: int = 256
    batch_size: int = 16
    batches: int = 20
    turns: int = 1

    @override
    def prepare(self) -> None:
        logging.disable(logging.WARNING)  # of the encoders

    @part("write")
    def write(self, encoder: str = "defaults", goal: Goal = WRITE_GOAL, **options: Any) -> Measurement:
        """Compares both writers, LeRobot's with these options, on the same frames, in seconds per frame."""
        episodes, num_frames = self._synthetic_episodes(), self.episodes * self.length
        with tempfile.TemporaryDirectory() as scratch:
            folders = (Path(scratch) / str(number) for number in itertools.count())
            name = f"writing a frame, LeRobot ({encoder}) / ours"
            sides = (
                lambda: write_ours(next(folders), episodes),
                lambda: write_lerobot(next(folders), episodes, **options),
            )
            return self.compare(name, *sides, goal, units=num_frames)

    @part("write_streaming")
    def write_streaming(self) -> Measurement:
        """Compares both writers, LeRobot's with its streaming encoder and our codec settings."""
        from lerobot.configs.video import RGBEncoderConfig

        ours = EncoderConfig()
        codec = RGBEncoderConfig(vcodec="h264", preset=ours.preset, crf=ours.crf, g=ours.gop_size)
        # The queue holds an episode: a full one drops frames.
        options = {"streaming_encoding": True, "encoder_queue_maxsize": 10_000, "rgb_encoder": codec}
        return self.write("streaming", NO_GOAL, **options)

    @part("read")
    def read(self) -> Measurement:
        """Compares both readers on the same batches of one dataset, in seconds per sample."""
        import torch
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        with cpu_threads(1), tempfile.TemporaryDirectory() as scratch:
            root = Path(scratch) / "dataset"
            write_ours(root, self._synthetic_episodes())
            started = time.perf_counter()
            resident = ResidentDataset(root)
            decoding_s = time.perf_counter() - started
            shape = (1 + (self.turns + 1) * self.batches, self.batch_size)
            order = np.random.default_rng(0).integers(0, len(resident), shape)
            stamps = {key: [step / FPS for step in steps] for key, steps in CHUNK.items()}
            stock = LeRobotDataset(
                "roboverse/speed", root=root, video_backend="pyav", delta_timestamps=stamps, return_uint8=True
            )
            theirs = iter(torch.utils.data.DataLoader(stock, batch_sampler=order.tolist(), num_workers=0))
            ours = (resident.sample(indices, CHUNK) for indices in order)
            first, their_first = next(ours), next(theirs)
            for key, values in first.items():
                if not values.equal(their_first[key]):
                    raise DatasetError(f"The readers disagree on '{key}'. Do not compare their speed.")
            what = f"reading a sample, batches of {self.batch_size}, LeRobot / ours"
            name = f"{what} (decoded beforehand in {decoding_s:.2f} s)"
            sides = (partial(next, ours), partial(next, theirs))
            return self.compare(name, *sides, READ_GOAL, calls=self.batches, units=self.batch_size)

    @part("read_busy")
    def read_busy(self) -> Measurement:
        """Compares our reader on two threads beside two processes that compute all the time to it alone."""
        with tempfile.TemporaryDirectory() as scratch:
            write_ours(Path(scratch) / "dataset", self._synthetic_episodes())
            resident = ResidentDataset(Path(scratch) / "dataset")
        shape = (_BUSY_TIMES * self.batches, self.batch_size)
        order = np.random.default_rng(0).integers(0, len(resident), shape)

        def alone() -> None:
            for indices in order:
                resident.sample(indices, CHUNK)

        def beside() -> None:
            for process in busy:
                process.resume()
            alone()
            for process in busy:
                process.suspend()

        with cpu_threads(_THREADS), _suspended(_BUSY_PROCESSES) as busy:
            name = f"reading a sample, {_THREADS} threads, alone / beside {_BUSY_PROCESSES} busy processes"
            return self.compare(name, beside, alone, BUSY_GOAL, units=order.size)

    def _synthetic_episodes(self) -> list[EpisodeData]:
        return [synthetic_episode(index, self.length, self.size) for index in range(self.episodes)]


@contextlib.contextmanager
def _suspended(count: int) -> Iterator[list[Any]]:
    """Yields processes that compute all the time once they are resumed."""
    import psutil

    command = [sys.executable, "-c", "while True: pass"]
    processes = [psutil.Popen(command, stdout=subprocess.DEVNULL) for _ in range(count)]
    try:
        for process in processes:
            process.suspend()
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def synthetic_episode(index: int, length: int, size: int) -> EpisodeData:
    """Returns an episode whose images cost an encoder about as much as rendered ones.

    They have ``length`` frames of ``size`` pixels a side: a shaded background, moving squares, and the sensor
    noise of one ray per pixel. ``index`` is the seed of the noise and the paths.
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


def write_ours(root: Path, episodes: Sequence[EpisodeData]) -> None:
    """Writes with our writer."""
    features = plain_features(episodes[0].images["front"].shape[1])
    with DatasetWriter(root, fps=FPS, features=features) as writer:
        for episode in episodes:
            writer.add_episode(episode)


def write_lerobot(root: Path, episodes: Sequence[EpisodeData], **options: Any) -> None:
    """Writes with LeRobot's writer."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = plain_features(episodes[0].images["front"].shape[1])
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
