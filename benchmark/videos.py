"""Records videos of episodes by running them again: an evaluation renders only what its policy needs."""

import logging
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmark.instruction_tests import Prompter, Script
from benchmark.records import EpisodeRecord
from benchmark.runner import Baseline, EvaluatedEnv, actor_of
from envs.core.atomic import atomic_path
from envs.rollout import Episode, rollout
from policies.base import Policy

logger = logging.getLogger(__name__)


def record_episode(
    policy: Policy | Baseline,
    env: EvaluatedEnv,
    episode: int,
    *,
    seed: int,
    every: int = 2,
    script: Script | None = None,
) -> tuple[np.ndarray, bool]:
    """Runs one episode again and films it.

    Args:
        policy: The policy.
        env: The environment that the episode was evaluated in.
        episode: Index in the task's pool of episodes.
        seed: The protocol's seed.
        every: A frame every so many control steps; the first and the last are always kept.
        script: Instructions in place of the episode's own.

    Returns:
        Frames (T, H, W, 3) uint8 of the first camera, and whether the episode succeeded.
    """
    frames: list[np.ndarray] = []
    prompter = None if script is None else Prompter(env, lambda _: script)

    def film(running: Episode) -> None:
        if prompter is not None:
            prompter(running)
        if running.length % every == 0:
            frames.append(env.image(running.env_id))

    actor = actor_of(policy, env, seed, "a video")
    (finished,) = rollout(env, actor, [episode], on_step=film)
    if finished.length % every:  # the environment is still where the episode ended
        frames.append(env.image(finished.env_id))
    return np.stack(frames), finished.success


def write_video(path: Path, frames: np.ndarray, fps: float) -> None:
    """Writes an H.264 video that browsers play, and its last frame beside it as a PNG.

    Args:
        path: The ``.mp4`` file; the poster has the same name and the suffix ``.png``.
        frames: Frames (T, H, W, 3) uint8.
        fps: Frames per second.

    Raises:
        WriteError: A file cannot be written.
    """
    import av
    from PIL import Image

    height, width = (size - size % 2 for size in frames.shape[1:3])  # yuv420p halves both
    options = {"movflags": "+faststart"}  # a browser starts before it has all of the file
    with (
        atomic_path(path, keep_suffix=True) as temporary,
        av.open(str(temporary), "w", options=options) as container,
    ):
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        # With its macroblock tree x264 writes other bytes each time for frames of 64 pixels and less.
        stream.options = {"crf": "20", "preset": "medium", "x264-params": "mbtree=0"}
        for frame in frames:
            cropped = np.ascontiguousarray(frame[:height, :width])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(cropped, format="rgb24")))
        container.mux(stream.encode())
    with atomic_path(path.with_suffix(".png"), keep_suffix=True) as temporary:
        Image.fromarray(frames[-1]).save(temporary, format="PNG", optimize=True)


def choose_episodes(records: Sequence[EpisodeRecord], count: int = 1) -> list[EpisodeRecord]:
    """Returns the first ``count`` failures and the first ``count`` successes: not the best, the first."""
    failures = [record for record in records if not record.success]
    successes = [record for record in records if record.success]
    return failures[:count] + successes[:count]


def film_cell(
    policy: Policy | Baseline,
    env: EvaluatedEnv,
    records: Sequence[EpisodeRecord],
    folder: Path,
    *,
    control_hz: float,
    count: int = 1,
    every: int = 2,
) -> list[Path]:
    """Films failures and successes of one cell, in real time.

    Args:
        policy: The policy.
        env: The cell's env.
        records: The cell's records.
        folder: Where the videos go; ``benchmark.results.video_dir`` is beside the result.
        control_hz: Control steps per second.
        count: How many failures, and how many successes.
        every: A frame every so many control steps.

    Returns:
        The videos, named ``<cell>-<episode>-<success|failure>.mp4``.

    Raises:
        WriteError: A video cannot be written.
    """
    paths = []
    for record in choose_episodes(records, count):
        script = None if record.instruction_test is None else Script.of(record)
        frames, success = record_episode(
            policy, env, record.episode, seed=record.seed, every=every, script=script
        )
        if success is not record.success:
            logger.warning(
                "Episode %d of %s succeeded=%s when it was evaluated and %s when recorded: this policy "
                "or simulator is not deterministic here.",
                record.episode,
                record.cell,
                record.success,
                success,
            )
        path = folder / f"{record.cell.name}-{record.episode}-{'success' if success else 'failure'}.mp4"
        write_video(path, frames, control_hz / every)
        paths.append(path)
    return paths
