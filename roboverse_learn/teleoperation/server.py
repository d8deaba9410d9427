"""The page and its websocket, over aiohttp.

Every path begins with a random token; whatever else is requested does not exist. The page comes from this
package and requests nothing from other hosts.
"""

import asyncio
import contextlib
import hmac
import json
import logging
import secrets
import ssl
import struct
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from envs.core.errors import ConfigError
from roboverse_learn.teleoperation.conductor import Frame
from roboverse_learn.teleoperation.limits import (
    MESSAGE_BURST,
    MESSAGES_PER_S,
    SILENCE_S,
    ConnectionWatch,
    TokenBucket,
)
from roboverse_learn.teleoperation.protocol import (
    MAX_MESSAGE_BYTES,
    Join,
    Move,
    ProtocolError,
    parse,
)
from roboverse_learn.teleoperation.session import Session

FRAMES_ON_THE_WAY = 2
"""Frames that are sent before the browser has the first: more would pile up."""

FORGET_S = 1.0
"""Seconds without such a word after which a frame is sent all the same."""

JOIN_S = 5.0
"""Seconds in which a websocket must join."""

HEARTBEAT_S = 5.0
"""Seconds between pings; a browser that does not answer in half of it is gone."""

OPENED_AGAIN = 4001
"""Code with which a page's websocket is closed where the same client joins again: that page stays away."""

SPARE_SOCKETS = 4
"""Websockets beside those of the operators: pages that are about to join, or are loaded again."""

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' "
    "blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

MAX_ROWS = 200
"""Episodes in the page's list, the newest."""

_SHOWN = ("index", "episode", "mark", "operator", "device", "seconds", "path_m", "idle_share")

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Seat:
    """What one operator's browser is sent; the newest alone, where it cannot keep up."""

    session: Session
    client: str = ""
    socket: web.WebSocketResponse | None = None
    status: str = ""
    episodes: str = ""
    frame: Frame | None = None
    sent: int = 0
    seen: int = 0
    sent_at: float = 0.0
    news: asyncio.Event = field(default_factory=asyncio.Event)


class TeleoperationServer:
    """Serves the page to operators, one for each session.

    Args:
        sessions: One per operator.
        facts: JSON-able: what the page is sent about the task at first.
        token: First part of every path; random by default.
    """

    def __init__(self, sessions: Sequence[Session], facts: Mapping[str, Any], token: str = "") -> None:
        self.token = token or secrets.token_urlsafe(16)
        self._seats = [_Seat(session) for session in sessions]
        self._facts = dict(facts)
        self._files = _page_files()
        self._sockets = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._runner: web.AppRunner | None = None
        self._watch: asyncio.Task[None] | None = None

    # -- life ----------------------------------------------------------------------------------------

    async def start(self, host: str, port: int, context: ssl.SSLContext | None = None) -> int:
        """Listens; returns the port, which the system chooses for 0.

        Raises:
            ConfigError: The port is taken, or there is no such address here.
        """
        self._loop = asyncio.get_running_loop()
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_MESSAGE_BYTES)
        app.router.add_get("/{token}/ws", self._socket)
        app.router.add_get("/{token}/{name:.*}", self._page)
        self._runner = web.AppRunner(app, access_log=None, keepalive_timeout=15.0, shutdown_timeout=1.0)
        await self._runner.setup()
        server = self._runner.server
        assert server is not None, "the runner is set up"
        self._connections = ConnectionWatch(lambda: server.connections, silence_s=SILENCE_S)
        self._watch = asyncio.create_task(self._connections.watch())
        try:
            await web.TCPSite(self._runner, host, port, ssl_context=context, backlog=32).start()
        except OSError as error:
            await self.stop()
            raise ConfigError(
                f"host={host} port={port}: {error.strerror}. Choose another port, or port=0 for a free one, "
                "and for host= an address of this machine."
            ) from error
        return int(self._runner.addresses[0][1])

    async def stop(self) -> None:
        """Closes every connection and stops listening."""
        if self._watch is not None:
            self._watch.cancel()
        for seat in self._seats:
            if seat.socket is not None:
                with contextlib.suppress(ConnectionError):
                    await seat.socket.close(code=WSCloseCode.GOING_AWAY, message=b"over")
        if self._runner is not None:
            await self._runner.cleanup()

    # -- what the conductor has to say, from its threads -----------------------------------------------

    def send_status(self, index: int, status: Mapping[str, Any]) -> None:
        """Sends a status."""
        self._say(index, status=json.dumps({"type": "status", **status}))

    def send_episodes(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Sends everybody the list of episodes."""
        shown = [{key: row[key] for key in _SHOWN} for row in rows[-MAX_ROWS:]]
        text = json.dumps({"type": "episodes", "rows": shown})
        for index in range(len(self._seats)):
            self._say(index, episodes=text)

    def show(self, index: int, frame: Frame) -> None:
        """Sends images."""
        self._say(index, frame=frame)

    def _say(self, index: int, **values: Any) -> None:
        def note() -> None:
            for key, value in values.items():
                setattr(self._seats[index], key, value)
            self._seats[index].news.set()

        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # the loop has just been closed
                self._loop.call_soon_threadsafe(note)

    # -- requests ------------------------------------------------------------------------------------

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Hides everything from those without the token."""
        token = request.match_info.get("token", "")
        with self._connections.serving(request.protocol):
            if not hmac.compare_digest(token.encode(), self.token.encode()):
                return web.Response(status=404, text="Not found.\n", headers=HEADERS)
            try:
                return await handler(request)
            except web.HTTPException as error:
                return web.Response(status=error.status, text=f"{error.reason}.\n", headers=HEADERS)

    async def _page(self, request: web.Request) -> web.Response:
        name = request.match_info["name"] or "index.html"
        if name not in self._files:
            raise web.HTTPNotFound
        kind = _TYPES[name.rpartition(".")[2]]
        return web.Response(body=self._files[name], content_type=kind, charset="utf-8", headers=HEADERS)

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        origin = request.headers.get("Origin")
        if origin is not None and origin.partition("://")[2] != request.host:
            raise web.HTTPForbidden
        if self._sockets >= len(self._seats) + SPARE_SOCKETS:
            raise web.HTTPServiceUnavailable
        socket = web.WebSocketResponse(
            max_msg_size=MAX_MESSAGE_BYTES, heartbeat=HEARTBEAT_S, compress=False, timeout=1.0
        )
        self._sockets += 1
        try:
            await socket.prepare(request)
            seat = await self._joined(socket)
            if seat is not None:
                await self._attend(socket, seat)
        except ProtocolError as error:
            await _close(socket, WSCloseCode.POLICY_VIOLATION, str(error))
        except ConnectionError:
            pass
        finally:
            self._sockets -= 1
        return socket

    async def _joined(self, socket: web.WebSocketResponse) -> _Seat | None:
        """Waits for the first message; returns the operator's seat, or None where all are taken."""
        try:
            message = await socket.receive(timeout=JOIN_S)
        except TimeoutError:
            raise ProtocolError("Nothing was said.") from None
        join = parse(message.data) if message.type is WSMsgType.TEXT else None
        if not isinstance(join, Join):
            raise ProtocolError("The first message must be join.")
        own = (seat for seat in self._seats if seat.client == join.client)
        # Somebody's whose connection was lost only where there is no other: they may come back.
        free = sorted(
            (seat for seat in self._seats if seat.socket is None), key=lambda seat: seat.client != ""
        )
        seat = next(own, None) or next(iter(free), None)
        if seat is None:
            await socket.send_str(json.dumps({"type": "full", "operators": len(self._seats)}))
            await _close(socket, WSCloseCode.TRY_AGAIN_LATER, "All environments are taken.")
            return None
        if seat.socket is not None:
            await _close(seat.socket, OPENED_AGAIN, "The page was opened again.")
        seat.client, seat.socket, seat.seen, seat.sent = join.client, socket, 0, 0
        seat.session.operator = join.operator
        return seat

    async def _attend(self, socket: web.WebSocketResponse, seat: _Seat) -> None:
        """Reads a browser's messages and sends it news, until it goes."""
        place = {"operator": self._seats.index(seat), "operators": len(self._seats)}
        bucket = TokenBucket(MESSAGES_PER_S, MESSAGE_BURST)
        sender: asyncio.Task[None] | None = None
        try:
            await socket.send_str(json.dumps({"type": "hello", **self._facts, **place}))
            seat.session.connected = True
            seat.session.version += 1
            sender = asyncio.create_task(_send_news(socket, seat))
            async for message in socket:
                if message.type is not WSMsgType.TEXT:
                    raise ProtocolError("Messages are texts.")
                if not bucket.take():
                    raise ProtocolError(f"More than {MESSAGES_PER_S:g} messages per second.")
                given = parse(message.data)
                if isinstance(given, Join):
                    raise ProtocolError("join comes first, and once.")
                if isinstance(given, Move):
                    seat.seen = min(max(seat.seen, given.seen), seat.sent)
                    seat.news.set()
                seat.session.submit(given)
        finally:
            if sender is not None:
                sender.cancel()
            if seat.socket is socket:
                seat.socket, seat.session.connected = None, False


async def _send_news(socket: web.WebSocketResponse, seat: _Seat) -> None:
    """Sends the newest status, episodes and frame of a seat as they come."""
    status = episodes = ""
    frame: Frame | None = None
    with contextlib.suppress(ConnectionError):
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(seat.news.wait(), FORGET_S)
            seat.news.clear()
            if seat.episodes != episodes:
                episodes = seat.episodes
                await socket.send_str(episodes)
            if seat.status != status:
                status = seat.status
                await socket.send_str(status)
            waited = time.monotonic() - seat.sent_at > FORGET_S
            may_send = waited or seat.sent - seat.seen < FRAMES_ON_THE_WAY
            if seat.frame is not None and seat.frame is not frame and may_send:
                frame, seat.sent_at = seat.frame, time.monotonic()
                seat.sent += 1
                await socket.send_bytes(encode_frame(frame, seat.sent))


def encode_frame(frame: Frame, number: int) -> bytes:
    """Returns a binary message: length of the header (uint32, little-endian), header in JSON, images.

    Args:
        frame: The images.
        number: Number of the message, which the browser sends back as ``seen``.
    """
    sizes = {camera: len(jpeg) for camera, jpeg in frame.jpegs.items()}
    values = {"frame": number, "seq": frame.seq, "step": frame.step, "images": sizes}
    header = json.dumps(values).encode()
    return b"".join((struct.pack("<I", len(header)), header, *frame.jpegs.values()))


async def _close(socket: web.WebSocketResponse, code: int, why: str) -> None:
    with contextlib.suppress(ConnectionError, asyncio.TimeoutError):
        await socket.close(code=code, message=why.encode()[:120])


def _page_files() -> dict[str, bytes]:
    folder = resources.files("roboverse_learn.teleoperation") / "page"
    return {
        file.name: file.read_bytes() for file in folder.iterdir() if file.name.rpartition(".")[2] in _TYPES
    }
