"""The processes of a collection: what they are told, and the pipe to each."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, Self

from envs.core.errors import ConfigError, DatasetError
from roboverse_learn.data.collection.schedule import GIVE_UP_AFTER
from roboverse_learn.data.dataset.schema import Feature
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY, staged_directory
from roboverse_learn.data.dataset.video import EncoderConfig


@dataclass(frozen=True, kw_only=True)
class CollectionConfig:
    """What to collect.

    Attributes:
        root: The dataset's folder; an existing one is continued.
        num_episodes: Successful episodes wanted in it.
        candidates: Pool indices in the order of preference, such as a split's.
        source: ``"package.module:function"`` that returns an
            :class:`~roboverse_learn.data.sources.base.EpisodeSource`.
        source_kwargs: JSON-able arguments of the function.
        fps: Frames per second.
        features: From :func:`~roboverse_learn.data.dataset.schema.make_features`.
        robot_type: Name of the robot.
        num_workers: Processes; 1 collects in this process.
        settings: JSON-able; what continuing the dataset must have in common with its beginning, such as
            task, level, seed. ``source_kwargs`` by default.
        encoder: Video settings.
        fewer_ok: Once every candidate was tried, fewer successes than ``num_episodes`` are a result too.
        give_up_after: Failures of a call before it may end because too few episodes succeed.
    """

    root: str | Path
    num_episodes: int
    candidates: Sequence[int]
    source: str
    source_kwargs: Mapping[str, Any]
    fps: int
    features: Mapping[str, Feature]
    robot_type: str | None = None
    num_workers: int = 1
    settings: Mapping[str, Any] | None = None
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    fewer_ok: bool = False
    give_up_after: int = GIVE_UP_AFTER

    def __post_init__(self) -> None:
        if self.num_episodes < 1 or self.num_workers < 1:
            raise ConfigError(
                f"num_episodes and num_workers must be at least 1, given {self.num_episodes} and "
                f"{self.num_workers}."
            )
        if len(set(self.candidates)) != len(self.candidates):
            raise ConfigError("The candidates name a pool episode twice. Give each index once.")


class Worker:
    """A worker process, seen from the collecting process."""

    def __init__(self, config: CollectionConfig, number: int) -> None:
        self.number = number
        self._root = Path(config.root)
        self.log = self._root / STAGING_DIRECTORY / f"worker_{number}.log"
        self.log.parent.mkdir(parents=True, exist_ok=True)
        threads = max((os.cpu_count() or 1) // config.num_workers, 1)
        environment = {"OMP_NUM_THREADS": str(threads), **os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        with open(self.log, "wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "roboverse_learn.data.collection.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=environment,
                start_new_session=True,  # Ctrl-C is for the collecting process, which then ends its workers
            )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._commands: IO[bytes] = self._process.stdin
        self.results: IO[bytes] = self._process.stdout
        self._buffer = b""
        self._work = {
            "root": str(self._root),
            "source": config.source,
            "source_kwargs": dict(config.source_kwargs),
            "features": dict(config.features),
            "fps": config.fps,
            "encoder": asdict(config.encoder),
        }

    def __enter__(self) -> Self:
        self.send(**self._work)
        return self

    def __exit__(self, *exc: object) -> None:
        if exc[0] is not None:
            self._process.terminate()
        with contextlib.suppress(OSError):
            self._commands.close()
        try:
            self._process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.results.close()
        if exc[0] is None:
            self.log.unlink(missing_ok=True)

    def staged_directory(self, index: int) -> Path:
        """Where the worker staged a pool episode."""
        return staged_directory(self._root, index)

    def send(self, **message: Any) -> None:
        """Sends one message; a worker that is gone shows when its results end."""
        with contextlib.suppress(BrokenPipeError):
            self._commands.write(json.dumps(message).encode() + b"\n")
            self._commands.flush()

    def messages(self) -> Iterator[dict[str, Any]]:
        """Yields the messages that have arrived.

        Raises:
            DatasetError: The worker died.
        """
        chunk = os.read(self.results.fileno(), 65536)
        if not chunk:
            code = self._process.wait()
            raise DatasetError(
                f"Collection worker {self.number} died (exit code {code}"
                f"{'; out of memory?' if code == -9 else ''}). Its log is '{self.log}'. The episodes so far "
                "are safe; run the same command again, with fewer workers if memory was short."
            )
        *lines, self._buffer = (self._buffer + chunk).split(b"\n")
        for line in lines:
            yield json.loads(line)
