"""Compares writing and reading with LeRobot's own, on the same frames, in one run.

Run ``python -m roboverse_learn.speed.dataset``. Frames are those of a tabletop scene as a renderer gives
it: a shaded background, moving objects, and the sensor noise of one ray per pixel; ``--frames-from`` takes
those of a dataset instead. Both sides do all of their work: encoding, statistics, metadata, fsync. LeRobot
runs with its defaults (PNG files, then SVT-AV1) and, as the stricter comparison, with its streaming
encoder at the same codec settings as ours. Batches are an ACT training step's: images, state, a chunk of
100 actions, in the same random order for both readers, one thread each, from the same dataset.
"""

import logging
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.errors import DatasetError
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.schema import IMAGE_PREFIX, EpisodeData, make_features
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.dataset.writer import DatasetWriter

FPS = 20
CAMERA = IMAGE_PREFIX + "front"
CHUNK_SIZE = 100
TASK = "lift the cube"
WRITE_GOAL, READ_GOAL = 3.0, 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Rate:
    """How fast one side was.

    Attributes:
        name: What ran.
        per_s: Frames (writing) or samples (reading) per second.
    """

    name: str
    per_s: float


def synthetic_episode(index: int, length: int, size: int) -> EpisodeData:
    """Returns an episode whose pictures cost an encoder about what rendered ones do.

    Args:
        index: Seed of the noise and the paths.
        length: Frames.
        size: Height and width.
    """
    rng = np.random.default_rng(index)
    y, x = np.mgrid[0:size, 0:size] * (256 / size)
    waves = (120 + 60 * np.sin(x / 40), 110 + 50 * np.cos(y / 55), 90 + 40 * np.sin((x + y) / 70))
    background = np.stack(waves, axis=-1) + rng.normal(0, 4, (size, size, 3))
    images = np.repeat(background.clip(0, 255).astype(np.uint8)[None], length, axis=0)
    half = size // 14
    for t in range(length):
        for k in range(4):
            column = int(size / 2 + size * 0.31 * np.sin(t / 20 + k + index))
            row = int(size / 2 + size * 0.31 * np.cos(t / 25 + 2 * k))
            images[t, row - half : row + half, column - half : column + half] = (
                40 * k + 30,
                200 - 30 * k,
                90,
            )
    return EpisodeData(
        states=rng.normal(size=(length, 9)).astype(np.float32),
        actions=rng.normal(size=(length, 9)).astype(np.float32),
        images={"front": images},
        task=TASK,
        raw={"qpos": rng.normal(size=(length + 1, 16)), "ctrl": rng.normal(size=(length, 9))},
        metadata={"episode": index},
    )


def episodes_of(root: Path, count: int) -> list[EpisodeData]:
    """Returns the first episodes of a dataset with one camera, decoded."""
    dataset = ResidentDataset(root, keys=["observation.state", "action", CAMERA])
    episodes = []
    for index in range(min(count, dataset.info.num_episodes)):
        part = slice(int(dataset.info.episode_starts[index]), int(dataset.info.episode_ends[index]))
        frames = {key: values[part].numpy() for key, values in dataset.frames.items()}
        images = np.ascontiguousarray(frames[CAMERA].transpose(0, 2, 3, 1))
        episodes.append(
            EpisodeData(
                states=frames["observation.state"],
                actions=frames["action"],
                images={"front": images},
                task=TASK,
                metadata={"episode": index},
            )
        )
    return episodes


def _features(episode: EpisodeData) -> dict[str, Any]:
    height, width = episode.images["front"].shape[1:3]
    states = [f"q{i}" for i in range(episode.states.shape[1])]
    actions = [f"u{i}" for i in range(episode.actions.shape[1])]
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
    dataset = LeRobotDataset.create("roboverse/benchmark", fps=FPS, features=features, root=root, **options)
    for episode in episodes:
        for t in range(episode.length):
            frame = {
                "observation.state": episode.states[t],
                "action": episode.actions[t],
                CAMERA: episode.images["front"][t],
                "task": TASK,
            }
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()


def compare_writers(folder: Path, episodes: Sequence[EpisodeData]) -> list[Rate]:
    """Writes the same frames three times; ours comes first."""
    from lerobot.configs.video import RGBEncoderConfig

    ours = EncoderConfig()
    same = RGBEncoderConfig(vcodec="h264", preset=ours.preset, crf=ours.crf, g=ours.gop_size)
    # The queue holds an episode: a full one drops frames.
    streaming = {"streaming_encoding": True, "encoder_queue_maxsize": 10_000, "rgb_encoder": same}
    # What happens once per process (imports, codec tables) is no part of writing.
    write_ours(folder / "warm_up_ours", episodes[:1])
    write_lerobot(folder / "warm_up_lerobot", episodes[:1])
    num_frames = sum(episode.length for episode in episodes)

    def rate(name: str, write: Callable[[], None]) -> Rate:
        start = time.perf_counter()
        write()
        return Rate(name=name, per_s=num_frames / (time.perf_counter() - start))

    return [
        rate("RoboVerse Learn", lambda: write_ours(folder / "ours", episodes)),
        rate("LeRobot, defaults", lambda: write_lerobot(folder / "lerobot", episodes)),
        rate("LeRobot, streaming", lambda: write_lerobot(folder / "stream", episodes, **streaming)),
    ]


def compare_readers(root: Path, batch_size: int, num_batches: int) -> tuple[list[Rate], float]:
    """Reads the same batches from one dataset with both readers.

    Returns:
        The rates, ours first, and the seconds that decoding the whole dataset took us beforehand.
    """
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    torch.set_num_threads(1)
    start = time.perf_counter()
    resident = ResidentDataset(root)
    decoding_s = time.perf_counter() - start
    order = np.random.default_rng(0).integers(0, len(resident), (num_batches + 1, batch_size))
    stamps = {"action": [i / FPS for i in range(CHUNK_SIZE)]}
    stock = LeRobotDataset(
        "roboverse/benchmark", root=root, video_backend="pyav", delta_timestamps=stamps, return_uint8=True
    )
    loader = iter(torch.utils.data.DataLoader(stock, batch_sampler=order.tolist(), num_workers=0))
    gathered = (resident.sample(indices, {"action": range(CHUNK_SIZE)}) for indices in order)
    _check_equal(next(gathered), next(loader))
    return [
        Rate(name="RoboVerse Learn", per_s=_samples_per_s(gathered, batch_size)),
        Rate(name="LeRobot", per_s=_samples_per_s(loader, batch_size)),
    ], decoding_s


def _check_equal(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Checks that both readers give the same batch."""
    import torch

    for key, values in ours.items():
        if not torch.equal(values, theirs[key]):
            raise DatasetError(f"The readers disagree on '{key}'. Do not compare their speed.")


def _samples_per_s(batches: Iterator[Any], batch_size: int) -> float:
    start, count = time.perf_counter(), 0
    for _ in batches:
        count += batch_size
    return count / (time.perf_counter() - start)


def _report(title: str, unit: str, rates: Sequence[Rate], goal: float) -> bool:
    """Writes rates and ratios; the ratio to the second side is held against the goal."""
    lines = [f"{title}"]
    ours = rates[0]
    lines += [
        f"  {rate.name:20s} {rate.per_s:10.0f} {unit}   {ours.per_s / rate.per_s:7.1f}x" for rate in rates
    ]
    reached = ours.per_s / rates[1].per_s >= goal
    lines.append(f"  goal {goal:.0f}x against {rates[1].name}: {'reached' if reached else 'MISSED'}")
    sys.stdout.write("\n".join(lines) + "\n")
    return reached


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasetBenchmark:
    """``python -m roboverse_learn.speed.dataset``: writing and reading, against LeRobot's own.

    Attributes:
        episodes: Episodes that are written.
        length: Frames of each.
        size: Height and width of a frame, pixels.
        batch_size: Frames of a batch that is read.
        batches: Batches that are read.
        frames_from: A dataset whose frames are used instead of drawn ones.
    """

    episodes: int = 3
    length: int = 100
    size: int = 256
    batch_size: int = 16
    batches: int = 20
    frames_from: Path | None = None


def main(words: Sequence[str] | None = None) -> int:
    """Runs the comparison; the exit code is 1 where a goal is missed."""
    return run_program("python -m roboverse_learn.speed.dataset", DatasetBenchmark, _compare, words)


def _compare(options: DatasetBenchmark) -> int:
    logging.disable(logging.WARNING)
    if options.frames_from:
        episodes = episodes_of(options.frames_from, options.episodes)
    else:
        episodes = [synthetic_episode(i, options.length, options.size) for i in range(options.episodes)]
    with tempfile.TemporaryDirectory() as folder:
        written = _report("Writing", "frames/s", compare_writers(Path(folder), episodes), WRITE_GOAL)
        rates, decoding_s = compare_readers(Path(folder) / "ours", options.batch_size, options.batches)
        read = _report(f"Training read, batches of {options.batch_size}", "samples/s", rates, READ_GOAL)
        frames = sum(episode.length for episode in episodes)
        sys.stdout.write(f"  decoding all {frames} frames once, beforehand: {decoding_s:.2f} s\n")
    return 0 if written and read else 1


if __name__ == "__main__":
    sys.exit(main())
