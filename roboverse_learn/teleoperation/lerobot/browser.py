"""A person at a browser steers the simulated robot of a LeRobot command."""

import asyncio
import logging
import ssl
import threading
import time
from dataclasses import dataclass
from typing import override

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from envs.core.errors import ConfigError
from envs.lerobot.robot import RoboVerseRobot
from envs.lerobot.teleoperators import SceneTeleoperator, held
from roboverse_learn.teleoperation.certificate import addresses, tls_of
from roboverse_learn.teleoperation.conductor import Frame, encode_jpeg
from roboverse_learn.teleoperation.lerobot.lent_session import LentSession
from roboverse_learn.teleoperation.server import TeleoperationServer
from roboverse_learn.teleoperation.station import check_steerable

logger = logging.getLogger(__name__)

_POLL_S = 0.05


@TeleoperatorConfig.register_subclass("roboverse_browser")
@dataclass(kw_only=True)
class RoboVerseBrowserConfig(TeleoperatorConfig):
    """Options of ``--teleop.type=roboverse_browser``.

    Attributes:
        host: Address on which the page is served.
        port: Its port; 0 is a free one.
        token: First part of the page's path; random where empty.
        https: Serve the page over https, for phones and headsets, with a self-signed certificate or ``cert``.
        cert: PEM file of a certificate, for https.
        key: PEM file of its key.
        wait_s: Seconds for which the command waits until somebody has opened the page; 0 does not wait.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token: str = ""
    https: bool = False
    cert: str = ""
    key: str = ""
    wait_s: float = 300.0


class RoboVerseBrowser(SceneTeleoperator):
    """The hand follows keyboard, mouse, touch, gamepad, phone or headset of whoever has the page open.

    The page is served from when the robot is connected, and the command waits there for the person.
    """

    config_class = RoboVerseBrowserConfig
    name = "roboverse_browser"

    def __init__(self, config: RoboVerseBrowserConfig) -> None:
        super().__init__(config)
        self._options = config
        self._session: LentSession | None = None
        self._page: _Page | None = None
        self._frames = 0

    @override
    def disconnect(self) -> None:
        super().disconnect()
        if self._page is not None:
            self._page.stop()
            self._page = None

    @override
    def plan(self, robot: RoboVerseRobot) -> np.ndarray:
        assert self._session is not None and self._page is not None, "a connected robot has a page"
        asked = self._session.next_action()
        self._show(robot)
        return (held(robot) if asked is None else asked)[None]

    @override
    def prepare(self, robot: RoboVerseRobot) -> None:
        """Serves the page of a robot, and waits until somebody has opened it."""
        check_steerable(robot.env)
        options, self._session = self._options, LentSession(robot)
        server = TeleoperationServer([self._session], self._session.page_facts(robot.images), options.token)
        context = tls_of(options.host, options.cert, options.key, https=options.https)
        self._page = _Page(server, options.host, options.port, context)
        scheme = "https" if context else "http"
        for host in addresses(options.host):
            logger.info("Open %s://%s:%d/%s/ in a browser.", scheme, host, self._page.port, server.token)
        self._show(robot)
        until = time.monotonic() + options.wait_s
        while not self._session.connected and options.wait_s:
            if time.monotonic() > until:
                raise ConfigError(
                    f"Nobody has opened the page within {options.wait_s:g} s. Give a larger --teleop.wait_s."
                )
            time.sleep(_POLL_S)

    def _show(self, robot: RoboVerseRobot) -> None:
        """Sends the newest images, and what the page shows beside them."""
        session, page = self._session, self._page
        if session is None or page is None:
            return
        self._frames += 1
        jpegs = {name: encode_jpeg(robot.images[name]) for name in session.cameras}
        frame = Frame(number=self._frames, seq=session.seq, step=session.step, jpegs=jpegs)
        page.server.show(0, frame)
        page.server.send_status(0, session.status())


class _Page:
    """A server in a thread of its own.

    Args:
        server: The server.
        host: Its address.
        port: Its port; 0 is a free one.
        context: Of a certificate, for https.

    Attributes:
        port: The port on which it listens.

    Raises:
        ConfigError: The port is taken.
    """

    def __init__(
        self, server: TeleoperationServer, host: str, port: int, context: ssl.SSLContext | None
    ) -> None:
        self.server, self.port = server, port
        self._address, self._context = (host, port), context
        self._ready, self._stop = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name="teleoperation page", daemon=True
        )
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

    async def _serve(self) -> None:
        try:
            self.port = await self.server.start(*self._address, self._context)
        except BaseException as error:
            self._error = error
            return
        finally:
            self._ready.set()
        while not self._stop.is_set():
            await asyncio.sleep(_POLL_S)
        await self.server.stop()

    def stop(self) -> None:
        """Closes the page."""
        self._stop.set()
        self._thread.join()
