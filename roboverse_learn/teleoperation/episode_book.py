"""Which episodes are steered next, and what became of those that were."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roboverse_learn.teleoperation.recording import Mark, Recording, RecordingFolder


class EpisodeBook:
    """Hands out episodes of the train split, in order, to several operators, and keeps their recordings.

    An episode of which there is a success is not handed out again, nor one that somebody has.

    Args:
        folder: Where recordings are written.
        pool: Episodes in the order in which they are tried.
        wanted: Successes wanted in the folder.

    Attributes:
        revision: Rises with every change of the recordings.
    """

    def __init__(self, folder: RecordingFolder, pool: Sequence[int], wanted: int) -> None:
        self._folder, self._pool, self.wanted = folder, pool, wanted
        self._out: set[int] = set()
        self._skipped: set[int] = set()
        self.revision = 0

    @property
    def kept(self) -> int:
        """Successes in the folder."""
        return self._folder.count(Mark.SUCCESS)

    @property
    def is_full(self) -> bool:
        """Whether there are as many successes as wanted."""
        return self.kept >= self.wanted

    @property
    def num_over(self) -> int:
        """Episodes that were handed out by this process and are over, whatever became of them."""
        return len(self._skipped)

    def take(self) -> int | None:
        """Hands out the next episode; None if there are enough successes, or no episode is left."""
        if self.is_full:
            return None
        gone = self._out | self._skipped | self._folder.solved_episodes()
        episode = next((index for index in self._pool if index not in gone), None)
        if episode is not None:
            self._out.add(episode)
        return episode

    def give_back(self, episode: int, *, skip: bool = False) -> None:
        """Takes back an episode; with ``skip`` it is not handed out again by this process."""
        self._out.discard(episode)
        if skip:
            self._skipped.add(episode)

    def add(self, recording: Recording) -> Path:
        """Keeps a recording; returns its file."""
        self.revision += 1
        return self._folder.add(recording)

    def discard(self, path: Path) -> None:
        """Marks a recording as discarded; its episode may be handed out again."""
        self.revision += 1
        self._skipped.discard(int(self._folder.facts[path]["episode"]))
        self._folder.remark(path, Mark.DISCARDED)

    def rows(self) -> list[dict[str, Any]]:
        """Returns the facts of every recording, in order, with the number of its file as ``index``."""
        facts = self._folder.facts.items()
        return [{"index": int(path.name.partition(".")[0]), **values} for path, values in facts]
