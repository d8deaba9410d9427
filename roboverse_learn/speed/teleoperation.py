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
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from roboverse_learn.config.other_commands import TeleoperateConfig
from roboverse_learn.speed.harness import Goal, Measurement, Program, measurement, part
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
class Teleoperation(Program):
    """Measures delays of teleoperation, all in one episode.

    Attributes:
        parts: delay, interval, lateness, latest.
        task: Registered task.
        view_size: Height and width of the images, pixels.
        seconds: Duration of the episode.
    """

    one_core: ClassVar = True

    task: str = "PickCube"
    view_size: int = 256
    seconds: float = 10.0

    @part("delay", "delay", "command to image at {}²", DELAY)
    @part("interval", "interval", "between images at {}²", INTERVAL)
    @part("lateness", "lateness", "lateness of a control step, 95 %", LATENESS)
    @part("latest", "latest", "lateness of the latest control step", LATENESS)
    def measured(self, figure: str, name: str, goal: Goal) -> Measurement:
        """Compares one of the figures of :func:`play` to rendering an image."""
        seconds = play(self)
        title = f"{name.format(self.view_size)} / an image alone"
        return measurement(title, np.array([[seconds[figure], seconds["image"]]]), goal)


@cache
def play(settings: Teleoperation) -> Mapping[str, float]:
    """Steers an episode over a websocket, and renders its images in a plain loop before.

    Returns:
        Seconds: ``image``, rendering one alone, median; ``delay``, from sending a motion to the arrival of
        the first image with its effect, median; ``interval`` between images, mean; ``lateness`` of a control
        step, 95th percentile, and ``latest``, that of the latest one.
    """
    from envs.spec import EnvSpec

    spec, limit_s = EnvSpec(task=settings.task), 2 * settings.seconds
    config = TeleoperateConfig(env=spec, view_size=settings.view_size, limit_s=limit_s)
    with tempfile.TemporaryDirectory() as folder, prepared(config, Path(folder)) as steering:
        times = []
        for index in steering.env.split_indices[: 1 + IMAGES]:  # an unchanged scene is not rendered again
            steering.env.reset_envs(np.array([0]), np.array([index]))
            began = time.perf_counter()
            steering.env.handler.render(steering.env.camera_names[:1])
            times.append(time.perf_counter() - began)
        played = asyncio.run(_steer(steering, settings.seconds))
    return {"image": float(np.median(times[1:])), **played}


async def _steer(steering: Steering, seconds: float) -> Mapping[str, float]:
    """Does what the page does, and returns what :func:`play` does but the time of an image."""
    import aiohttp

    sent: dict[int, float] = {}  # when each motion was sent that no image has shown yet
    delays, arrivals, seen = list[float](), list[float](), 0

    async def move(socket: aiohttp.ClientWebSocketResponse) -> None:
        """Sends motions until it is cancelled, each with a number of its own and the image that was seen."""
        began = time.perf_counter()
        for seq in itertools.count(1):
            sent[seq] = now = time.perf_counter()
            rate = [0.1 * math.sin(now), 0.1 * math.cos(now), 0.0, 0.0, 0.0, 0.0]
            motion = {"type": "move", "seq": seq, "rate": rate, "device": "script", "seen": seen}
            await socket.send_json(motion)
            await asyncio.sleep(max(0.0, began + seq * SEND_S - time.perf_counter()))

    async with conducted(steering, "127.0.0.1", 0) as (conductor, url), aiohttp.ClientSession() as http:
        async with http.ws_connect(f"{url}ws") as socket:
            await socket.send_json({"type": "join", "client": "speed"})
            await socket.send_json({"type": "press", "button": "start"})
            mover = asyncio.create_task(move(socket))
            began = time.perf_counter()
            while time.perf_counter() - began < seconds or len(arrivals) <= WARM_UP + 1:
                message = await socket.receive(10.0)
                if message.type is not aiohttp.WSMsgType.BINARY:
                    continue
                arrivals.append(time.perf_counter())
                (size,) = struct.unpack_from("<I", message.data)
                header = json.loads(message.data[4 : 4 + size])
                seen = header["frame"]
                shown = [seq for seq in sent if seq <= header["seq"]]
                delays += [arrivals[-1] - sent.pop(seq) for seq in shown]
            mover.cancel()
        _, late_ms, latest_ms = conductor.figures().late_ms
    return {
        "delay": float(np.median(delays)),
        "interval": float(np.diff(arrivals[WARM_UP:]).mean()),
        "lateness": max(late_ms, 1e-3) / 1e3,
        "latest": max(latest_ms, 1e-3) / 1e3,
    }
