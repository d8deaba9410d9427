"""Teleoperation on one core, server and client together: ``roboverse speed teleoperation``.

A client of the websocket moves the hand as often as the page does while images come as fast as they are
rendered, without shadows, as on every machine of one core.
Goals are absolute: a person notices a delay, whatever the machine. The baseline is the image in a plain loop.
"""

import asyncio
import itertools
import json
import math
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from roboverse_learn.config.teleoperate_config import TeleoperateConfig
from roboverse_learn.speed.harness import Goal, Measurement, Settings, program
from roboverse_learn.teleoperation.conductor import Figures
from roboverse_learn.teleoperation.run import Steering, conducted, prepared

DELAY = Goal(0.080, at_least=False, absolute=True)
INTERVAL = Goal(1 / 15, at_least=False, absolute=True)
LATENESS = Goal(0.050, at_least=False, absolute=True)
"""A control step of 20 Hz."""

SEND_S = 0.033
"""Time between motions that are sent (``page/page.js``)."""

WARM_UP = 3
"""First images whose intervals do not count."""

IMAGES = 20
"""Images of the baseline."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TeleoperationSettings(Settings):
    """Settings of ``roboverse speed teleoperation``.

    Attributes:
        task: Registered task.
        view_size: Height and width of the images, pixels.
        seconds: Duration of the episode.
    """

    task: str = "PickCube"
    view_size: int = 256
    seconds: float = 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Played:
    """What a client saw of an episode, and what the same image costs in a plain loop.

    Attributes:
        delay_s: From sending a motion to the arrival of the first image with its effect, median.
        interval_s: Between images, mean.
        image_s: Rendering an image alone, median.
        figures: How the server kept time.
    """

    delay_s: float
    interval_s: float
    image_s: float
    figures: Figures


def parts(settings: TeleoperationSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured, all of it in one episode."""
    size = f"at {settings.view_size}²"
    return {
        "delay": partial(_measured, settings, f"command to image {size}", "delay", DELAY),
        "interval": partial(_measured, settings, f"between images {size}", "interval", INTERVAL),
        "lateness": partial(_measured, settings, "lateness of a control step, 95 %", "lateness", LATENESS),
    }


def _measured(settings: TeleoperationSettings, name: str, what: str, goal: Goal) -> Measurement:
    played = play(settings.task, settings.view_size, settings.seconds)
    late_s = max(played.figures.late_ms[1], 1e-3) / 1e3
    ours = {"delay": played.delay_s, "interval": played.interval_s, "lateness": late_s}[what]
    return Measurement(
        name=f"{name} / an image alone",
        ours_s=ours,
        baseline_s=played.image_s,
        ratio=ours / played.image_s,
        goal=goal,
    )


@cache
def play(task: str, view_size: int, seconds: float) -> Played:
    """Steers an episode over a websocket, and renders its images in a plain loop before."""
    from envs.spec import EnvSpec

    config = TeleoperateConfig(env=EnvSpec(task=task), view_size=view_size, limit_s=2 * seconds)
    with tempfile.TemporaryDirectory() as folder, prepared(config, Path(folder)) as steering:
        steering.env.handler.render(steering.env.camera_names[:1])
        images = [_timed(steering) for _ in range(IMAGES)]
        delays, interval, figures = asyncio.run(_steer(steering, seconds))
    return Played(
        delay_s=float(np.median(delays)),
        interval_s=interval,
        image_s=float(np.median(images)),
        figures=figures,
    )


def _timed(steering: Steering) -> float:
    began = time.perf_counter()
    steering.env.handler.render(steering.env.camera_names[:1])
    return time.perf_counter() - began


async def _steer(steering: Steering, seconds: float) -> tuple[list[float], float, Figures]:
    """Returns the delays, the time between images, and the server's figures."""
    import aiohttp

    async with conducted(steering, "127.0.0.1", 0) as (conductor, url), aiohttp.ClientSession() as http:
        async with http.ws_connect(f"{url}ws") as socket:
            await socket.send_str(json.dumps({"type": "join", "client": "speed"}))
            await socket.send_str(json.dumps({"type": "press", "button": "start"}))
            client = _Client(socket)
            sender = asyncio.create_task(client.send())
            await client.receive(seconds)
            sender.cancel()
        figures = conductor.figures()
    warm = client.arrivals[WARM_UP:]
    return client.delays, (warm[-1] - warm[0]) / (len(warm) - 1), figures


class _Client:
    """What the page does: it sends a motion every 33 ms, and says which image it has seen.

    Args:
        socket: A websocket that has joined.

    Attributes:
        delays: Of each motion that an image showed, s.
        arrivals: When the images came, s.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._sent, self._seen = socket, {}, 0
        self.delays: list[float] = []
        self.arrivals: list[float] = []

    async def send(self) -> None:
        """Sends motions, each with a number of its own, until it is cancelled."""
        began = time.perf_counter()
        for seq in itertools.count(1):
            now = time.perf_counter()
            self._sent[seq] = now
            rate = [0.1 * math.sin(now), 0.1 * math.cos(now), 0.0, 0.0, 0.0, 0.0]
            move = {"type": "move", "seq": seq, "rate": rate, "device": "script", "seen": self._seen}
            await self._socket.send_str(json.dumps(move))
            await asyncio.sleep(max(0.0, began + seq * SEND_S - time.perf_counter()))

    async def receive(self, seconds: float) -> None:
        """Notes when images come, and which motions they are the first to show."""
        import aiohttp

        began = time.perf_counter()
        while time.perf_counter() - began < seconds or len(self.arrivals) <= WARM_UP + 1:
            message = await self._socket.receive(10.0)
            if message.type is not aiohttp.WSMsgType.BINARY:
                continue
            now = time.perf_counter()
            (size,) = struct.unpack_from("<I", message.data)
            header = json.loads(message.data[4 : 4 + size])
            self._seen = header["frame"]
            self.arrivals.append(now)
            shown = [seq for seq in self._sent if seq <= header["seq"]]
            self.delays += [now - self._sent.pop(seq) for seq in shown]


if __name__ == "__main__":
    sys.exit(program("teleoperation", TeleoperationSettings, parts, one_core=True))
