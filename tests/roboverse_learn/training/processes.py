"""Run by conftest.py: a process that has imported everything, and forks others to be killed or launched.

The imports take longer than the training. It reads one JSON request per line and answers with one.
"""

import importlib
import json
import os
import random
import signal
import socket
import sys
import time
import warnings
from pathlib import Path
from types import ModuleType


def find_tests() -> None:
    """Makes ``tests`` ours; another distribution's may be installed."""
    root = Path(__file__).parents[3]
    sys.path.insert(0, str(root))
    package = ModuleType("tests")
    package.__path__ = [str(root / "tests")]
    sys.modules["tests"] = package


def forked(work, *arguments) -> int:
    """Calls a function in a child process and returns the child's number."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work(*arguments)
            code = 0
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            sys.stderr.flush()
            os._exit(code)
    return child


def launch(folder: str, signal_at: int | None = None) -> list[int]:
    """Trains in two processes with the environment that ``accelerate launch`` gives; returns exit codes.

    At the step ``signal_at`` only the first of them gets the signal.
    """
    from tests.roboverse_learn.training.signals import SignalAt
    from tests.roboverse_learn.training.test_distributed import run

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    def rank(number: int) -> None:
        os.environ |= {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
        os.environ |= {"ACCELERATE_USE_CPU": "true", "RANK": str(number), "LOCAL_RANK": str(number)}
        run(Path(folder), SignalAt(signal_at) if signal_at else None)

    children = [forked(rank, number) for number in (0, 1)]
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def kill(folder: str, kills: int) -> list[int]:
    """Kills runs that resume from each other with SIGKILL; returns the step that each had logged."""
    from roboverse_learn.training.metrics import read_metrics
    from tests.roboverse_learn.training.imitation.test_killed import STEPS, Waits, run

    rng, reached, seen = random.Random(0), [], 0
    for number in range(kills):
        wanted = STEPS * (number + 1) // (kills + 1)
        child = forked(run, Path(folder), Waits(wanted + 4))
        deadline = time.monotonic() + 60
        while seen < wanted and time.monotonic() < deadline:
            time.sleep(0.01)
            seen = max((row["step"] for row in read_metrics(Path(folder))), default=0)
        time.sleep(rng.uniform(0.0, 0.15))
        os.kill(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code == -signal.SIGKILL, f"The run ended with {code} before it could be killed."
        reached.append(max(row["step"] for row in read_metrics(Path(folder))))
    return reached


def main() -> None:
    find_tests()
    for name in ("roboverse_learn.training.imitation.train", "tests.roboverse_learn.training.frames"):
        importlib.import_module(name)

    for line in sys.stdin:
        request = json.loads(line)
        answer = {"launch": launch, "kill": kill}[request.pop("do")](**request)
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
