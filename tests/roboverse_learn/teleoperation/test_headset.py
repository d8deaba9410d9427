"""A headset steers: the whole page in Node, over https, against a server; and its messages alone."""

import asyncio
import contextlib
import json
import math
import shutil
import threading

import numpy as np
import pytest

from envs.rotations import from_matrix, multiply, to_matrix
from envs.spec import EnvSpec
from roboverse_learn.teleoperation.certificate import self_signed, tls
from roboverse_learn.teleoperation.conductor import Conductor
from roboverse_learn.teleoperation.recording import Mark
from roboverse_learn.teleoperation.server import TeleoperationServer
from roboverse_learn.teleoperation.session import Phase, Session
from roboverse_learn.teleoperation.station import Station
from tests.roboverse_learn.teleoperation import node
from tests.roboverse_learn.teleoperation.scripted_client import Follower

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not node.has_websocket(), reason="no Node from version 20.10 on is installed"),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl makes a certificate"),
]

TRIGGER, SQUEEZE, STICK, LOWER, UPPER = 0, 1, 3, 4, 5


@contextlib.asynccontextmanager
async def served(book, folder):
    """Yields the session of a page over https, its address, and the certificate."""
    env = EnvSpec(task="PickCube", image_size=32).make(1, num_threads=1)
    drawing = threading.Lock()
    session = Session(Station(env, 0, drawing), book, limit_s=60.0)
    facts = {"task": "PickCube", "cameras": list(env.camera_names), "control_hz": 20.0}
    facts |= {
        "delta_m": session.station.controller.delta_m,
        "delta_rad": session.station.controller.delta_rad,
    }
    server = TeleoperationServer([session], facts)
    conductor = Conductor(env, [session], drawing=drawing, on_status=server.send_status, on_frame=server.show)
    file = self_signed(["127.0.0.1"], folder)
    port = await server.start("127.0.0.1", 0, tls(str(file), str(file)))
    await asyncio.to_thread(conductor.start)
    try:
        yield session, f"https://127.0.0.1:{port}/{server.token}/", file
    finally:
        conductor.stop()
        await server.stop()
        env.close()
    assert conductor.error is None


class Person:
    """Holds the right controller of a headset, whose pose is in the space of the floor: y up, -z ahead."""

    def __init__(self, page):
        self._page, self.position, self.turn = (
            page,
            np.array([0.2, 1.1, -0.3]),
            np.array([0.8, 0.0, 0.6, 0.0]),
        )

    async def frame(self, *buttons, **fields):
        w, x, y, z = self.turn.tolist()
        pose = [*self.position.tolist(), x, y, z, w]
        source = json.dumps({"pose": pose, "buttons": list(buttons), **fields})
        await self._page.value(f"xr.frame([{source}])")
        await asyncio.sleep(0.02)

    async def tap(self, button):
        await self.frame()
        await self.frame(button)
        await self.frame()

    async def move(self, world, view_yaw, *buttons):
        """Moves and turns by a motion (6,) of the world, m and rad, as seen by a camera of this direction."""
        cos, sin = math.cos(view_yaw), math.sin(view_yaw)

        def seen(x, y, z):  # right, up, -away: the axes of the floor
            return np.array([sin * x - cos * y, z, -(cos * x + sin * y)])

        self.position = self.position + seen(*world[:3])
        vector = seen(*world[3:])
        angle = max(float(np.linalg.norm(vector)), 1e-12)
        step = np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * vector / angle])
        self.turn = from_matrix(to_matrix(step) @ to_matrix(self.turn))
        await self.frame(SQUEEZE, *buttons)


async def eventually(condition, seconds=20.0):
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.02)


async def enter(page):
    await page.until("document.body.dataset.phase === 'ready'")
    await page.until("!at('enter-vr').hidden")
    assert await page.value("[at('device-headset').textContent, at('enter-ar').hidden]") == [
        "Headset found",
        True,
    ]
    await page.value("at('enter-vr').fire('click')")
    assert await page.value("xr.session !== null && xr.frames.length === 1")


@contextlib.asynccontextmanager
async def worn(book, folder):
    """Yields the session of a page that a headset shows, the page, and who wears the headset."""
    async with served(book, folder) as (session, url, file), node.opened(url, folder, file) as page:
        await enter(page)
        yield session, page, Person(page)


async def steer(page, person, session, follower):
    """Plays the present episode with the controller."""
    episode, view_yaw = session.episode, session.station.view_yaw("front")
    controller = session.station.controller
    follower.begin(episode)
    await person.tap(LOWER)
    await page.until("document.body.dataset.phase === 'running'")
    closed = False
    limits = np.array([controller.delta_m] * 3 + [controller.delta_rad] * 3)
    async with asyncio.timeout(100):
        while session.episode == episode:
            rate, gripper = follower.motion(session.status()["hand"])
            presses = [TRIGGER] if (gripper < 0) != closed else []
            closed = gripper < 0
            await person.move(0.25 * limits * np.array(rate), view_yaw, *presses)
            if presses:
                await asyncio.sleep(0.3)


def test_a_headset_plays_a_whole_pick_cube_over_https(folder, book, pick_cube, tmp_path):
    async def body():
        async with worn(book, tmp_path) as (session, page, person):
            await steer(page, person, session, Follower(pick_cube))
            await page.until("at('progress').textContent.startsWith('1 of 2')")
            drawn = await page.value("xr.calls.webgl.filter(([name]) => name === 'drawArrays').length")
            assert drawn > 100, "the images hang on the wall, for two eyes"
            words = await page.value(
                "xr.calls['2d'].filter(([name]) => name === 'fillText').map((call) => call[1])"
            )
            assert any("recording" in line and " of 2 episodes" in line for line in words)

    asyncio.run(asyncio.wait_for(body(), 150))
    marks = [(facts["mark"], facts["device"]) for facts in folder.facts.values()]
    assert marks == [(Mark.SUCCESS, "webxr")]


def test_the_hand_goes_where_the_controller_does_and_rests_when_it_is_let_go_or_lost(book, tmp_path):
    async def body():
        async with worn(book, tmp_path) as (session, page, person):
            yaw = session.station.view_yaw("front")
            await person.frame(SQUEEZE)
            await person.move([0.0, 0.0, 0.1, 0, 0, 0], yaw)
            assert session.step == 0, "nothing moves before start"
            await person.tap(LOWER)
            await page.until("document.body.dataset.phase === 'running'")

            def hand():
                found = session.station.hand()
                return np.array(found["pos"]), np.array(found["rot"])

            async def settled():
                await person.frame(SQUEEZE)
                for _ in range(15):
                    await person.frame(SQUEEZE)
                return hand()

            before, turned = await settled()
            for _ in range(20):
                await person.move([-0.002, 0.004, 0.003, 0, 0, 0], yaw)
            after, still = await settled()
            assert after - before == pytest.approx([-0.04, 0.08, 0.06], abs=0.004)
            assert abs(still @ turned) > 0.9999
            for _ in range(20):
                await person.move([0, 0, 0, 0.01, 0, 0.015], yaw)
            there, now = await settled()
            assert there == pytest.approx(after, abs=0.004)
            angle = math.hypot(0.2, 0.3)  # about one axis of the world
            vector = np.array([0.2, 0.0, 0.3]) / angle * math.sin(angle / 2)
            wanted = multiply(np.concatenate([[math.cos(angle / 2)], vector]), still)
            assert abs(wanted @ now) > math.cos(0.02 / 2), "within 0.02 rad"

            right = np.array([0.01, 0.0, 0.0])

            # Let go, repositioned, and grasped again; out of the cameras' sight; the system's menu.
            async def rests(*buttons, **fields):
                start = hand()[0]
                for _ in range(15):
                    person.position = person.position + right
                    await person.frame(*buttons, **fields)
                assert hand()[0] == pytest.approx(start, abs=1e-4)
                assert (await settled())[0] == pytest.approx(start, abs=1e-4)

            await rests()
            await rests(SQUEEZE, emulated=True)
            await rests(SQUEEZE, pose=None)
            await rests(SQUEEZE, hand={})
            await page.value(
                "(xr.session.visibilityState = 'visible-blurred', xr.session.fire('visibilitychange'))"
            )
            start = hand()[0]
            await person.move([0, 0, 0.05, 0, 0, 0], yaw)
            await asyncio.sleep(0.2)
            assert hand()[0] == pytest.approx(start, abs=1e-4)
            await page.value("(xr.session.visibilityState = 'visible', xr.session.fire('visibilitychange'))")

    asyncio.run(asyncio.wait_for(body(), 100))


def test_the_buttons_of_a_controller_and_the_end_of_the_session(book, tmp_path):
    async def body():
        async with worn(book, tmp_path) as (session, page, person):
            yaw = session.station.view_yaw("front")
            await person.tap(LOWER)
            await page.until("document.body.dataset.phase === 'running'")
            await person.frame(SQUEEZE)
            await person.move([0, 0, 0.02, 0, 0, 0], yaw)
            await person.tap(TRIGGER)
            await eventually(lambda: session.station.gripper() < 0)
            await person.tap(STICK)
            await eventually(lambda: session.note.startswith("One second taken back."))
            await page.until("document.body.dataset.phase === 'paused'")
            await person.tap(LOWER)
            await page.until("document.body.dataset.phase === 'running'")
            await page.value("xr.session.end()")
            await eventually(lambda: session.phase is Phase.PAUSED)
            await page.until("at('device-headset').textContent === 'Headset found'")
            await page.value("at('enter-vr').fire('click')")
            await person.tap(UPPER)
            await eventually(lambda: session.phase is Phase.READY and session.step == 0)

    asyncio.run(asyncio.wait_for(body(), 60))


def test_a_headset_taken_off_pauses_and_a_refused_session_is_reported(book, tmp_path):
    async def body():
        async with worn(book, tmp_path) as (session, page, person):
            # Some browsers call the page hidden while its session is shown.
            await page.value("(page.hidden = true, page.fire('visibilitychange'))")
            await person.tap(LOWER)
            await eventually(lambda: session.phase is Phase.RUNNING)
            await page.value("(page.fire('visibilitychange'))")
            await asyncio.sleep(0.2)
            assert session.phase is Phase.RUNNING
            await page.until("document.body.dataset.phase === 'running'")
            await page.value("(xr.session.visibilityState = 'hidden', xr.session.fire('visibilitychange'))")
            await eventually(lambda: session.phase is Phase.PAUSED)
            await page.value("xr.session.end()")
            await page.value(
                "navigator.xr.requestSession = async () => { throw new Error('not now'); }, null"
            )
            await page.value("at('enter-vr').fire('click')")
            assert await page.value("at('device-headset').textContent") == "Headset: not now"

    asyncio.run(asyncio.wait_for(body(), 60))


SLOW = (  # a browser asks the system which sessions there are
    "navigator.xr.isSessionSupported = (mode) => "
    "new Promise((done) => setTimeout(done, 10, mode === 'immersive-vr')), null"
)

THROWS = "{ throw new Error('%s'); }"
GRAPHICS = "Object.defineProperty(globalThis, 'XRWebGLLayer', {value: class { constructor() %s }}), null"
SESSION = "(xr.broken = {%s() %s}), null"

BROKEN = {
    "Headset: no WebGL here": GRAPHICS % THROWS % "no WebGL here",
    "Headset: no floor here": SESSION % ("async requestReferenceSpace", THROWS % "no floor here"),
    "Headset: it has ended": SESSION % ("requestAnimationFrame", THROWS % "it has ended"),
}


@pytest.mark.parametrize("reason", BROKEN)
def test_a_session_that_cannot_begin_leaves_its_reason_and_may_be_tried_again(book, tmp_path, reason):
    async def body():
        async with served(book, tmp_path) as (_, url, file), node.opened(url, tmp_path, file) as page:
            await page.until("!at('enter-vr').hidden")
            await page.value(SLOW)
            await page.value(BROKEN[reason])
            for _ in range(2):
                await page.value("at('device-headset').textContent = '', at('enter-vr').fire('click')")
                await asyncio.sleep(0.1)
                assert await page.value("at('device-headset').textContent") == reason

    asyncio.run(asyncio.wait_for(body(), 60))
