"""The words of the call that is being answered, which results record."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_CALLED_WITH: ContextVar[tuple[str, ...] | None] = ContextVar("called_with", default=None)


@contextmanager
def called_with(words: Sequence[str]) -> Iterator[None]:
    """Records words as those of the call inside the block; only ``key=value`` words count."""
    token = _CALLED_WITH.set(tuple(word for word in words if "=" in word))
    try:
        yield
    finally:
        _CALLED_WITH.reset(token)


def command_words() -> list[str]:
    """Returns the ``key=value`` words of this call, or those that this process was started with."""
    called = _CALLED_WITH.get()
    return [word for word in sys.argv[1:] if "=" in word] if called is None else list(called)
