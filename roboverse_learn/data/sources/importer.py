"""Demonstrations of other projects, as the collection wants them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, override

from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.importers.demonstration import DemonstrationFile
from roboverse_learn.data.importers.replayer import Replay, Replayer
from roboverse_learn.data.importers.verdicts import open_demonstrations
from roboverse_learn.data.sources.expert import ExpertSource


class ImportSource(ExpertSource):
    """Replays demonstrations with the looks of episodes of the train split.

    Args:
        source: Format of the files.
        root: Folder of the files.
        replay: ``states`` or ``controls``.
        files: File, relative to ``root``, to the SHA-256 of its content.
        demonstrations: Episode of the train split, in words, to file and name of what is replayed there.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertSource`.
    """

    def __init__(
        self,
        *,
        source: str,
        root: str,
        replay: Replay,
        files: Mapping[str, str],
        demonstrations: Mapping[str, Sequence[str]],
        **scene: Any,
    ) -> None:
        super().__init__(**scene)
        self._format, self._root, self._hashes = source, Path(root), files
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
            self._open[name] = open_demonstrations(self._format, self._root / name, self._env.task)
        return self._open[name]

    @override
    def close(self) -> None:
        for opened in self._open.values():
            opened.close()
        super().close()


def make_import_source(**kwargs: Any) -> ImportSource:
    """Builds an :class:`ImportSource`: what collecting processes call by name."""
    return ImportSource(**kwargs)
