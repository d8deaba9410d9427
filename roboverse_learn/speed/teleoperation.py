"""Teleoperation on one core, server and client together: ``roboverse speed teleoperation``.

A client of the websocket moves the hand at every control step while images come as fast as they are rendered.
Goals are absolute: a person notices a delay, whatever the machine. The baseline is the image in a plain loop.
"""

import asyncio
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

import numpy as np

from roboverse_learn.config.teleoperate_config import TeleoperateConfig
from roboverse_learn.speed.harness import Goal, Measurement, Settings, program
from roboverse_learn.teleoperation.conductor import Figures
from roboverse_learn.teleoperation.run import Steering, conducted, prepared

DELAY = Goal(0.080, at_least=False, absolute=True)
INTERVAL = Goal(1 / 15, at_least=False, absolute=True)
LATENESS = Goal(0.050, at_least=False, absolute=True)
"""A control step of 20 Hz."""

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
        delay_s: From sending a motion to the arrival of the first image that shows it, median.
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
            sent, delays, arrivals, seen = {}, [], [], 0
            began = time.perf_counter()
            while (now := time.perf_counter()) - began < seconds:
                message = await socket.receive(10.0)
                if message.type is aiohttp.WSMsgType.BINARY:
                    now = time.perf_counter()
                    (size,) = struct.unpack_from("<I", message.data)
                    header = json.loads(message.data[4 : 4 + size])
                    seen = header["frame"]
                    arrivals.append(now)
                    if header["seq"] in sent:
                        delays.append(now - sent[header["seq"]])
                    sent = {seq: at for seq, at in sent.items() if seq > header["seq"]}
                seq = len(arrivals) + int(1e3 * (now - began))
                sent[seq] = now
                rate = [0.1 * math.sin(now), 0.1 * math.cos(now), 0.0, 0.0, 0.0, 0.0]
                move = {"type": "move", "seq": seq, "rate": rate, "device": "script", "seen": seen}
                await socket.send_str(json.dumps(move))
        figures = conductor.figures()
    warm = arrivals[3:]
    return delays, (warm[-1] - warm[0]) / (len(warm) - 1), figures


if __name__ == "__main__":
    sys.exit(program("teleoperation", TeleoperationSettings, parts, one_core=True))
