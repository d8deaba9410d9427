"""Bounds on what strangers can do to a server: rates of messages, and connections that say nothing."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

MESSAGES_PER_S, MESSAGE_BURST = 120.0, 240
"""Messages of one browser per second, and at once; our page sends at most 60 per second."""

MAX_CONNECTIONS = 64
SILENCE_S = 10.0
"""Seconds in which a connection must have sent a whole request."""


class TokenBucket:
    """Allows a rate with bursts.

    Args:
        rate: Tokens per second.
        burst: Tokens at most.
        clock: Returns seconds.
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._tokens, self._then = burst, clock()

    def take(self) -> bool:
        """Takes a token; returns whether there was one."""
        now = self._clock()
        self._tokens = min(self._burst, self._tokens + self._rate * (now - self._then))
        self._then = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class ConnectionWatch:
    """Closes connections that are too many, or that have sent no whole request for too long.

    aiohttp bounds the size of a request, and not how long it may take to arrive.

    Args:
        connections: Returns the server's present connections: aiohttp's ``web.Server.connections``.
        silence_s: See :data:`SILENCE_S`.
        most: See :data:`MAX_CONNECTIONS`.
    """

    def __init__(
        self,
        connections: Callable[[], Iterable[Any]],
        *,
        silence_s: float = SILENCE_S,
        most: int = MAX_CONNECTIONS,
    ) -> None:
        self._connections, self._silence_s, self._most = connections, silence_s, most
        self._served: set[Any] = set()
        self._since: dict[Any, float] = {}

    @contextlib.contextmanager
    def serving(self, connection: Any) -> Iterator[None]:
        """Surrounds the answer to a request of a connection, which is not closed meanwhile."""
        self._served.add(connection)
        try:
            yield
        finally:
            self._served.discard(connection)

    def sweep(self, now: float) -> int:
        """Closes what breaks the bounds; returns how many.

        Args:
            now: Seconds of a clock that never goes back.
        """
        waiting = [each for each in self._connections() if each not in self._served]
        self._since = {each: self._since.get(each, now) for each in waiting}
        closed = [each for each in waiting if now - self._since[each] >= self._silence_s]
        others = [each for each in waiting if each not in closed]
        closed += others[self._most :]
        for connection in closed:
            if connection.transport is not None:
                connection.transport.abort()
        return len(closed)

    async def watch(self, every_s: float = 0.5) -> None:
        """Sweeps until cancelled."""
        while True:
            await asyncio.sleep(every_s)
            self.sweep(time.monotonic())
