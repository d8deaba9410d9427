"""Demonstrations in files of other projects, replayed in our environments."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, override

from envs.spec import EnvSpec
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.importers.demonstration import DemonstrationFile
from roboverse_learn.data.importers.replayer import Replay, Replayer
from roboverse_learn.data.importers.verdicts import (
    ImportSummary,
    find_files,
    judge,
    known_summary,
    write_summary,
)
from roboverse_learn.data.sources.base import DemonstrationSource, Progress, imported, spec_changes
from roboverse_learn.data.sources.expert import ExpertEpisodes

_CONDITIONS = ("task", "task_kwargs", "simulator")
"""Fields of the environment that decide whether a demonstration succeeds."""


class FileSource(DemonstrationSource):
    """A format of the files of ``path``: demonstrations that succeed in our environment are kept.

    Attributes:
        file_type: Reads the format.
    """

    episodes: ClassVar = "roboverse_learn.data.sources.importer:FileEpisodes"
    needs: ClassVar = {"path": "<file or folder>."}
    num_demos_is_most: ClassVar = True
    file_type: ClassVar[type[DemonstrationFile]]

    _verdicts: ImportSummary

    @override
    def prepare(self, dataset: Path, progress: Progress) -> None:
        """Replays every demonstration without images, to find those that succeed."""
        config, path = self.config, Path(self.config.path)
        conditions: dict[str, Any] = {key: getattr(config.env, key) for key in _CONDITIONS}
        conditions |= spec_changes(config.env)
        given: Any = {"file_type": self.file_type, "path": path, "replay": config.replay}
        find_files(self.file_type, path)  # a wrong path is reported before a simulator starts
        known = known_summary(dataset, **given, conditions=conditions)
        if known is None:
            env = EnvSpec(**conditions).make(config.collect.num_envs)
            with contextlib.closing(env), progress("replaying") as show:
                known = judge(
                    **given,
                    env=env,
                    conditions=conditions,
                    on_progress=lambda done, total: show(done, total, ""),
                )
        self._verdicts = known

    @override
    def name_part(self) -> str:
        config = self.config
        return f"{config.source}-{Path(config.path).name.partition('.')[0]}-by-{config.replay}"

    @override
    def identity(self) -> dict[str, Any]:
        return self._verdicts.identity()

    @override
    def candidates(self) -> list[int]:
        return [verdict.episode for verdict in self._verdicts.chosen()]

    @override
    def arguments(self) -> dict[str, Any]:
        path = Path(self.config.path)
        chosen = self._verdicts.chosen()
        return (
            super().arguments()
            | self.identity()
            | {
                "file_type": f"{self.file_type.__module__}:{self.file_type.__qualname__}",
                "root": str(path if path.is_dir() else path.parent),
                "demonstrations": {str(verdict.episode): (verdict.file, verdict.name) for verdict in chosen},
            }
        )

    @override
    def advice_for_task(self) -> str:
        return "Try the other way to replay: replay=states or replay=controls."

    @override
    def finish(self, dataset: Path) -> ImportSummary:
        write_summary(dataset, self._verdicts)
        return self._verdicts


class FileEpisodes(ExpertEpisodes):
    """Replays demonstrations with the appearance of episodes of the train split.

    Args:
        source: Name of the files' format.
        file_type: ``"package.module:Class"`` that reads them.
        root: Folder of the files.
        replay: ``states`` or ``controls``.
        files: File, relative to ``root``, to the SHA-256 of its content.
        demonstrations: Episode of the train split, in words, to file and name of what is replayed there.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(
        self,
        *,
        source: str,
        file_type: str,
        root: str,
        replay: Replay,
        files: Mapping[str, str],
        demonstrations: Mapping[str, Sequence[str]],
        **scene: Any,
    ) -> None:
        super().__init__(**scene)
        self._format, self._root, self._hashes = source, Path(root), files
        self._file_type: type[DemonstrationFile] = imported(file_type)
        self._by: Replay = replay
        self._demonstrations = demonstrations
        self._replayer = Replayer(self._env)
        self._open: dict[str, DemonstrationFile] = {}

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        places = [self._demonstrations[str(index)] for index in indices]
        demonstrations = [self._file(file).read(name) for file, name in places]
        outcomes = self._replayer.replay(demonstrations, indices, self._by)
        for (file, _), demonstration, outcome in zip(places, demonstrations, outcomes, strict=True):
            facts = {
                "source": self._format,
                "replay": self._by,
                "file": file,
                "file_sha256": self._hashes[file],
                "demonstration": demonstration.name,
                "file_success": demonstration.succeeded,
                **demonstration.facts,
            }
            yield outcome.episode, self._episode(outcome, **facts) if outcome.success else None

    def _file(self, name: str) -> DemonstrationFile:
        if name not in self._open:
            self._open[name] = self._file_type(self._root / name, self._env.task)
        return self._open[name]

    @override
    def close(self) -> None:
        for opened in self._open.values():
            opened.close()
        super().close()
