"""The finished cells of an evaluation, kept until its results file is whole.

A killed evaluation resumes with its next cell. The hidden file beside the results file counts only for the
same evaluation: its key holds every setting that decides an episode.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.protocol import Cell
from benchmark.records import EpisodeRecord, by_cell
from envs.core.atomic import write_file
from envs.core.fingerprint import fingerprint

log = logging.getLogger(__name__)


class FinishedCells:
    """Records of the cells that are done.

    Args:
        path: The results file that they will be in.
        key: Plain values: everything that decides what an episode is and does.

    Attributes:
        records: The records of every finished cell, ordered by episode as the split is.
    """

    def __init__(self, path: Path, key: Mapping[str, Any]) -> None:
        self.path = path.with_name(f".{path.stem}.cells.json")
        self._key = fingerprint(dict(key))
        self.records: dict[Cell, list[EpisodeRecord]] = self._read()

    def add(self, cell: Cell, records: Sequence[EpisodeRecord]) -> None:
        """Keeps a cell, atomically.

        Raises:
            WriteError: The file cannot be written.
        """
        self.records[cell] = list(records)
        rows = [record.to_json() for records in self.records.values() for record in records]
        write_file(self.path, json.dumps({"key": self._key, "records": rows}).encode())

    def remove(self) -> None:
        """Removes them all: the results file is whole."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> dict[Cell, list[EpisodeRecord]]:
        try:
            document = json.loads(self.path.read_bytes())
            if document["key"] != self._key:
                return {}
            records = [EpisodeRecord.from_json(row) for row in document["records"]]
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError) as error:
            log.warning(
                "The finished cells in '%s' cannot be read (%s); they are evaluated again.", self.path, error
            )
            return {}
        return by_cell(records)
