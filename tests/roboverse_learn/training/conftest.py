import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")


class Processes:
    """The process of processes.py: imports while the test does something else, and answers requests."""

    def __init__(self, log: Path) -> None:
        self._log = log
        with log.open("w") as stream:
            self._process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("processes.py"))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stream,
                text=True,
            )

    def ask(self, do: str, **arguments: object) -> None:
        self._process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
        self._process.stdin.flush()

    def answer(self) -> list[int]:
        line = self._process.stdout.readline()
        assert line, self.errors()
        return json.loads(line)

    def errors(self) -> str:
        return self._log.read_text()[-3000:]

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=60)
        self._process.stdout.close()


@pytest.fixture(scope="session")
def processes(tmp_path_factory):
    """Real processes to kill or to launch together."""
    server = Processes(tmp_path_factory.mktemp("processes") / "log")
    yield server
    server.close()
