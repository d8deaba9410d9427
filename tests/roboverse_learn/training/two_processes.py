"""Run by test_distributed.py: two processes with the environment that ``accelerate launch`` gives.

It forks after the imports, which take longer than the training.
"""

import os
import socket
import sys
import warnings
from pathlib import Path
from types import ModuleType


def main(folder: str) -> int:
    root = Path(__file__).parents[3]
    sys.path.insert(0, str(root))
    package = ModuleType("tests")  # another distribution's `tests` may be installed
    package.__path__ = [str(root / "tests")]
    sys.modules["tests"] = package
    from tests.roboverse_learn.training.test_distributed import run

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    os.environ |= {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    os.environ |= {"ACCELERATE_USE_CPU": "true"}
    child = os.fork()
    rank = "0" if child else "1"
    os.environ |= {"RANK": rank, "LOCAL_RANK": rank}
    run(Path(folder))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) if child else 0


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.exit(main(sys.argv[1]))
