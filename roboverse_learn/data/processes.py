"""What processes that are spawned to work beside this one have in common."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from multiprocessing import parent_process
from types import ModuleType


def end_with_parent() -> None:
    """Prepares a spawned process: Ctrl-C is for its parent, and it ends when that does, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def script_of_processes(script: ModuleType | None) -> Iterator[None]:
    """Lets processes that start here run a script first; without one, none is run, so it needs no guard."""
    main = sys.modules["__main__"]
    if main is script:
        yield
        return
    names = {name: vars(main)[name] for name in ("__file__", "__spec__") if name in vars(main)}
    main.__spec__ = None
    vars(main).pop("__file__", None)
    try:
        yield
    finally:
        vars(main).update(names)
