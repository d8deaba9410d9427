"""An import that is interrupted inside a compiled module, which says that the import failed."""

import contextlib
import signal
from collections.abc import Iterator

from roboverse_learn.training.interruption import Interrupted


@contextlib.contextmanager
def interrupts_of_imports() -> Iterator[None]:
    """Raises the interrupt that an ImportError hides.

    Ctrl-C while a module of pybind11 begins is an ImportError, "initialization failed", which the interrupt
    caused; what imports that module may raise an error of its own from it.

    Raises:
        Interrupted: An ImportError came of an interrupt, by the same signal.
    """
    try:
        yield
    except Exception as error:
        interrupt = _interrupt_behind(error)
        if interrupt is None:
            raise
        by = interrupt.exit_code - 128 if isinstance(interrupt, Interrupted) else signal.SIGINT
        raise Interrupted(by) from error  # a new one: that one is the cause of this error already


def _interrupt_behind(error: BaseException) -> KeyboardInterrupt | None:
    """Returns the interrupt that an ImportError among the causes of an error came of; None for none."""
    cause: BaseException | None = error
    seen: list[BaseException] = []  # a chain may be a ring
    failed = False
    while cause is not None and cause not in seen:
        if failed and isinstance(cause, KeyboardInterrupt):
            return cause
        seen.append(cause)
        failed = failed or isinstance(cause, ImportError)
        cause = cause.__cause__ or (cause.__context__ if failed else None)
    return None
