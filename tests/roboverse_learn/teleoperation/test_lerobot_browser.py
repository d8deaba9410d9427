"""A person at a browser steers the robot of a LeRobot command, whose loop decides when time passes."""

import asyncio
import contextlib
import shutil
import socket
import threading

import aiohttp
import numpy as np
import pytest
from lerobot.teleoperators import make_teleoperator_from_config

from envs.core.errors import ConfigError
from envs.lerobot import RoboVerseRobot, RoboVerseRobotConfig
from roboverse_learn.teleoperation.lerobot import RoboVerseBrowserConfig
from tests.roboverse_learn.teleoperation.scripted_client import Client

pytestmark = pytest.mark.slow


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Person:
    """A browser in a thread of its own: it joins, and steers the hand along +x until it is stopped."""

    def __init__(self, port, scheme):
        self.client, self.stop, self.moved = None, threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._live(f"{scheme}://127.0.0.1:{port}/word/ws")), daemon=True
        )
        self._thread.start()

    async def _live(self, url):
        async with aiohttp.ClientSession() as session:
            while True:  # the page is served once the robot is connected
                try:
                    socket = await session.ws_connect(url, ssl=False)
                    break
                except aiohttp.ClientError:
                    await asyncio.sleep(0.05)
            self.client = Client(socket)
            await self.client.join()
            await self.client.until("hello")
            await self.client.say(type="press", button="discard")
            while not self.stop.is_set():
                await self.client.move([0.5, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)
                self.moved.set()
                with contextlib.suppress(TimeoutError):
                    await self.client.read(0.2)
            await socket.close()
        await asyncio.sleep(0.25)  # a session of aiohttp does not wait for the end of TLS

    def leave(self):
        self.stop.set()
        self._thread.join(20)


def hand_x(robot):
    return float(next(iter(robot.env.get_states([0]).robots.values())).ee_pos[0, 0])


def test_the_hand_follows_the_person_and_leaves_episodes_to_lerobot(tmp_path, monkeypatch, caplog):
    robot = RoboVerseRobot(RoboVerseRobotConfig(image_size=32, calibration_dir=tmp_path))
    port = free_port()
    https = shutil.which("openssl") is not None  # phones and headsets steer by https alone
    options = RoboVerseBrowserConfig(
        port=port, token="word", wait_s=60.0, calibration_dir=tmp_path, https=https
    )
    teleop = make_teleoperator_from_config(options)
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path))
    caplog.set_level("INFO")
    person = Person(port, scheme := "https" if https else "http")
    teleop.connect()
    try:
        robot.connect()  # returns as soon as the person is there
        person.moved.wait(20)
        assert f"Open {scheme}://127.0.0.1:{port}/word/ in a browser." in caplog.text
        first, start = robot.episode, hand_x(robot)
        for _ in range(30):
            robot.get_observation()
            robot.send_action(teleop.get_action())
            threading.Event().wait(0.02)
        assert hand_x(robot) > start + 0.1  # half of 5 cm in each of up to 30 steps
        assert robot.episode == first and "LeRobot keeps and ends episodes" in teleop._session.note
        robot.begin_episode()
        robot.get_observation()
        robot.send_action(teleop.get_action())
        assert person.client.frames and person.client.hello["task"] == "PickCube"
        person.leave()
        for _ in range(60):  # nobody steers any more: the arm settles at its targets
            robot.send_action(teleop.get_action())
        speed = next(iter(robot.env.get_states([0]).robots.values())).joint_vel[0, :7]
        assert np.abs(speed.numpy()).max() < 0.01
    finally:
        person.leave()
        robot.disconnect()
        teleop.disconnect()


def test_a_page_that_nobody_opens_is_an_error(tmp_path):
    robot = RoboVerseRobot(RoboVerseRobotConfig(image_size=32, calibration_dir=tmp_path))
    options = RoboVerseBrowserConfig(port=0, wait_s=0.2, calibration_dir=tmp_path)
    teleop = make_teleoperator_from_config(options)
    teleop.connect()
    try:
        with pytest.raises(ConfigError, match=r"Nobody has opened the page within 0\.2 s\. Give a larger"):
            robot.connect()
        assert not robot.is_connected
    finally:
        teleop.disconnect()
