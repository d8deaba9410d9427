"""One process of a collection: simulates, encodes, stages, and asks for the next pool index.

Messages are lines of JSON: on standard input what to do, on standard output what was done. When the
collecting process dies, the input ends and so does this process.
"""

import json
import os
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from envs.core.errors import RoboVerseError
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.sources.base import make_source, run_attempts, stage_attempt


class _Channel:
    """The pipe to the collecting process."""

    def __init__(self, commands: TextIO, results: TextIO) -> None:
        self._commands, self._results = commands, results

    def receive(self) -> dict[str, Any]:
        line = self._commands.readline()
        if not line:  # the collecting process is gone
            raise SystemExit(1)
        return json.loads(line)

    def send(self, **message: Any) -> None:
        self._results.write(json.dumps(message) + "\n")
        self._results.flush()

    def ask(self, *, wait: bool) -> int | None:
        """Asks for a pool index; with ``wait``, None means that the collection is over."""
        self.send(want="wait" if wait else "now")
        return self.receive()["index"]

    def indices(self, first: int) -> Iterator[int]:
        """Yields ``first``, and whatever the collecting process gives without waiting."""
        index: int | None = first
        while index is not None:
            yield index
            index = self.ask(wait=False)


def main() -> int:
    """Runs one worker."""
    # Libraries print to standard output; the results keep it to themselves.
    results = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    channel = _Channel(sys.stdin, results)
    try:
        work = channel.receive()
        _run(channel, work)
    except RoboVerseError as error:
        channel.send(error=str(error))
        return 2
    except Exception as error:
        traceback.print_exc()
        channel.send(error=f"{type(error).__name__}: {error}", bug=True)
        return 1
    return 0


def _run(channel: _Channel, work: dict[str, Any]) -> None:
    """Works until the collection is over."""
    root, encoder = Path(work["root"]), EncoderConfig(**work["encoder"])
    source = make_source(work["source"], work["source_kwargs"])
    try:
        while (first := channel.ask(wait=True)) is not None:
            for index, episode in run_attempts(source, channel.indices(first)):
                staged = stage_attempt(
                    root, index, episode, features=work["features"], fps=work["fps"], encoder=encoder
                )
                channel.send(done=index, success=staged is not None)
    finally:
        source.close()


if __name__ == "__main__":
    sys.exit(main())
