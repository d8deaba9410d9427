"""The page in a headless Chromium: keys, mouse, pads, a phone, and a gamepad that plays a whole PickCube."""

import asyncio
import contextlib
import math
import threading

import aiohttp
import numpy as np
import pytest

from envs.rotations import yaw_of
from envs.spec import EnvSpec
from roboverse_learn.teleoperation.conductor import Conductor
from roboverse_learn.teleoperation.recording import Mark
from roboverse_learn.teleoperation.server import TeleoperationServer
from roboverse_learn.teleoperation.session import Phase, Session
from roboverse_learn.teleoperation.station import Station
from tests.roboverse_learn.teleoperation import chromium
from tests.roboverse_learn.teleoperation.scripted_client import Client, Follower

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.PROGRAM is None, reason="no Chromium is installed"),
]

GAMEPAD = """
window.pad = {connected: true, axes: [0, 0, 0, 0],
  buttons: [...Array(16)].map(() => ({pressed: false})), mapping: "standard"};
Object.defineProperty(navigator, "getGamepads", {value: () => [window.pad]});
document.getElementById("speed").value = 1;
"""

CONNECTED = "document.getElementById('device-gamepad').textContent === 'Gamepad connected'"


@contextlib.asynccontextmanager
async def served(book):
    env = EnvSpec(task="PickCube", image_size=32).make(1, num_threads=1)
    drawing = threading.Lock()
    session = Session(Station(env, 0, drawing), book, limit_s=60.0)
    facts = {"task": "PickCube", "cameras": list(env.camera_names), "delta_m": 0.05, "control_hz": 20.0}
    server = TeleoperationServer([session], facts)
    conductor = Conductor(env, [session], drawing=drawing, on_status=server.send_status, on_frame=server.show)
    port = await server.start("127.0.0.1", 0)
    await asyncio.to_thread(conductor.start)
    try:
        yield session, f"http://127.0.0.1:{port}/{server.token}/"
    finally:
        conductor.stop()
        await server.stop()
        env.close()
    assert conductor.error is None


async def tap(page, code):
    await page.key(code, down=True)
    await page.key(code, down=False)


async def eventually(condition, seconds=20.0):
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.02)


def axes(rate, view_yaw):
    """Returns a gamepad's axes for a rate (6,) in the world: its sticks are in the frame of the image."""
    x, y, z, _, _, yaw = rate
    away = math.cos(view_yaw) * x + math.sin(view_yaw) * y
    right = math.sin(view_yaw) * x - math.cos(view_yaw) * y

    def lifted(value):  # above the dead zone
        return math.copysign(0.12 + 0.88 * abs(value), value) if abs(value) > 1e-3 else 0.0

    return [lifted(right), lifted(-away), lifted(-yaw), lifted(-z)]


async def steer(page, session, follower):
    """Plays the present episode with the fake gamepad."""
    episode, view_yaw = session.episode, session.station.view_yaw("front")
    follower.begin(episode)
    await page.value("window.pad.buttons[9].pressed = true")
    await page.until("document.body.dataset.phase === 'running'")
    await page.value("window.pad.buttons[9].pressed = false")
    closed = False
    while session.episode == episode:
        rate, gripper = follower.motion(session.status()["hand"])
        await page.value(f"window.pad.axes = {axes([value / 2 for value in rate], view_yaw)}")
        if (gripper < 0) != closed:
            closed = not closed
            for pressed in ("true", "false"):
                await page.value(f"window.pad.buttons[0].pressed = {pressed}")
                await asyncio.sleep(0.1)
        await asyncio.sleep(0.03)


def test_keys_steer_and_a_gamepad_plays_a_whole_pick_cube(folder, book, pick_cube, tmp_path):
    async def body():
        async with served(book) as (session, url), chromium.browser() as page:
            await page.open(url)
            await page.until("document.body.dataset.phase === 'ready'")
            await page.until("document.querySelector('canvas').width === 32")
            before = session.station.hand()["pos"]
            await tap(page, "Enter")
            await page.until("document.body.dataset.phase === 'running'")
            await page.key("KeyA", down=True)  # left in the image; the camera faces the robot: -y is left
            await eventually(lambda: session.step > 5)
            await page.key("KeyA", down=False)
            after = session.station.hand()["pos"]
            assert after[1] < before[1] - 0.02
            assert abs(after[0] - before[0]) < 0.01 and abs(after[2] - before[2]) < 0.01
            await tap(page, "KeyG")
            await eventually(lambda: session.station.gripper() < 0)
            await tap(page, "KeyP")
            await eventually(lambda: session.phase is Phase.PAUSED)
            await tap(page, "KeyY")
            await eventually(lambda: session.phase is Phase.READY and session.step == 0)
            await page.until("document.getElementById('gripper-text').textContent === 'Close gripper'")

            await page.value(GAMEPAD)
            await page.until(CONNECTED)
            await steer(page, session, Follower(pick_cube))
            await page.until("document.getElementById('progress').textContent.startsWith('1 of 2')")
            assert not page.problems, page.problems
            assert all(request.startswith((url, "data:", "blob:")) for request in page.requests)

    asyncio.run(asyncio.wait_for(body(), 150))
    marks = [(facts["mark"], facts["device"]) for facts in folder.facts.values()]
    assert marks == [(Mark.DISCARDED, "keyboard"), (Mark.SUCCESS, "gamepad")]


SENT = """
window.sent = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  window.sent.push({ms: performance.now(), ...JSON.parse(text)}); send.call(this, text); };
"""


@contextlib.asynccontextmanager
async def opened(book):
    """Yields the session and the page, ready, whose messages ``window.sent`` lists from now on."""
    async with served(book) as (session, url), chromium.browser() as page:
        await page.open(url)
        await page.until("document.body.dataset.phase === 'ready'")
        await page.value(SENT)
        yield session, page
        assert not page.problems, page.problems


async def rests(page):
    """Returns whether the next motion that is sent is none."""
    await page.value("window.sent.length = 0")
    await page.until("window.sent.some(({type}) => type === 'move')")
    return await page.value("window.sent.findLast(({type}) => type === 'move').rate.every((value) => !value)")


async def click(page, selector):
    x, y = await page.middle(selector)
    await page.mouse("mousePressed", x, y, buttons=1)
    await page.mouse("mouseReleased", x, y, buttons=1)


def test_a_key_that_is_let_go_beside_a_modifier_or_in_a_text_field_moves_nothing_more(book):
    async def body():
        async with opened(book) as (_, page):

            async def hold():
                await page.key("KeyW", down=True)
                assert not await rests(page)

            for modifier, bit in (("ControlLeft", 2), ("AltRight", 1), ("MetaLeft", 4)):
                await hold()
                await page.key(modifier, down=True, modifiers=bit)
                assert await rests(page), "macOS does not tell when a key is let go beside Command"
                await page.key("KeyW", down=False, modifiers=bit)
                await page.key(modifier, down=False)
                assert await rests(page)
            await hold()
            await click(page, "#operator")
            await page.key("KeyW", down=False)
            assert await rests(page)

    asyncio.run(asyncio.wait_for(body(), 60))


async def presses(page):
    """Returns the buttons whose presses were sent since the last call."""
    return await page.value(
        "window.sent.splice(0).filter(({type}) => type === 'press').map(({button}) => button)"
    )


async def tab_to(page, name):
    for _ in range(40):
        await tap(page, "Tab")
        if await page.value("document.activeElement.id") == name:
            return
    raise AssertionError(f"Tab never reaches {name}")


def test_a_control_reached_by_tab_has_enter_space_and_the_arrows(book):
    async def body():
        async with opened(book) as (_, page):
            speed = "Number(document.getElementById('speed').value)"
            await tab_to(page, "discard")
            await tap(page, "Enter")
            assert await presses(page) == ["discard"]
            await tab_to(page, "undo")
            await tap(page, "Space")
            assert await presses(page) == ["undo"]
            await tab_to(page, "speed")
            before = await page.value(speed)
            await page.key("ArrowUp", down=True)
            assert await rests(page) and await page.value(speed) > before
            await page.key("ArrowUp", down=False)
            await page.key("KeyW", down=True)
            assert not await rests(page), "a letter is no key of the control"
            await page.key("KeyW", down=False)
            await tap(page, "Tab")  # the Name field
            await tap(page, "Tab")
            assert await page.value("document.activeElement.type") == "checkbox"
            await page.value("document.activeElement.onchange = () => { window.toggled = true; }")
            await tap(page, "Space")
            assert await page.value("window.toggled") and await presses(page) == []

    asyncio.run(asyncio.wait_for(body(), 60))


def test_a_control_that_was_clicked_leaves_the_keys_to_the_arm(book):
    async def body():
        async with opened(book) as (_, page):
            speed = "document.getElementById('speed').value"
            for control in ("#speed", "#help summary", "#reset", "#gripper"):
                await click(page, control)
                await page.value("window.sent.length = 0")
                await tap(page, "KeyW")  # makes what has the focus :focus-visible
                before = await page.value(speed)
                await page.key("ArrowUp", down=True)
                assert not await rests(page), control
                await page.key("ArrowUp", down=False)
                assert await page.value(speed) == before
                await tap(page, "Space")
                assert await presses(page) == ["takeover"], control
            await tab_to(page, "speed")
            await click(page, "#speed")
            await page.key("ArrowUp", down=True)
            assert not await rests(page), "what was reached by Tab, and then clicked"

    asyncio.run(asyncio.wait_for(body(), 60))


def test_the_keys_are_the_arms_once_a_name_is_entered(book):
    async def body():
        async with opened(book) as (session, page):
            await click(page, "#operator")
            await page.call("Input.insertText", text="Ada")
            await tap(page, "Enter")
            assert await page.value("document.activeElement === document.body")
            await eventually(lambda: session.operator == "Ada")
            await click(page, "#operator")
            await page.call("Input.insertText", text=" L")
            await tap(page, "Tab")
            assert await page.value("document.activeElement.type") == "checkbox", "Tab goes on as ever"

    asyncio.run(asyncio.wait_for(body(), 60))


def test_the_press_that_wakes_a_gamepad_does_nothing(book):
    async def body():
        async with opened(book) as (_, page):
            await page.value(GAMEPAD)
            for _ in range(2):  # when it comes first, and when it comes back
                await page.value("window.pad.connected = false")
                await page.until(f"!({CONNECTED})")
                await page.value("window.pad.buttons[1].pressed = window.pad.connected = true")
                await page.until(CONNECTED)
                await page.value("window.pad.buttons[1].pressed = false")
                await asyncio.sleep(0.2)
                assert await presses(page) == []
                await page.value("window.pad.buttons[1].pressed = true")
                await page.until("window.sent.some(({type}) => type === 'press')")
                await page.value("window.pad.buttons[1].pressed = false")
                await asyncio.sleep(0.2)
                assert await presses(page) == ["discard"]

    asyncio.run(asyncio.wait_for(body(), 60))


@pytest.mark.parametrize("phase", [Phase.READY, Phase.OVER])
def test_a_page_that_is_displaced_by_its_copy_says_so_and_stays_away(book, phase):
    async def body():
        async with (
            served(book) as (session, url),
            chromium.browser() as page,
            aiohttp.ClientSession() as http,
        ):
            await page.open(url)
            await page.until("document.body.dataset.phase === 'ready'")
            session.phase, session.version = phase, session.version + 1
            await page.until(f"document.body.dataset.phase === '{phase}'")
            async with http.ws_connect(f"{url}ws") as copy:
                client = Client(copy)
                await client.join(await page.value("sessionStorage.client"))
                await page.until("document.body.dataset.phase === 'connecting'")
                note = await page.value("document.getElementById('note').textContent")
                assert note == "This page was opened again elsewhere."
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(2.0):
                        async for _ in copy:
                            pass

    asyncio.run(asyncio.wait_for(body(), 60))


def test_a_page_that_finds_no_place_asks_ever_more_seldom(book):
    async def body():
        async with (
            served(book) as (_, url),
            aiohttp.ClientSession() as http,
            http.ws_connect(f"{url}ws") as other,
            chromium.browser() as page,
        ):
            await Client(other).join("other")
            await page.open(url)
            await page.value(SENT)
            joins = "window.sent.filter(({type}) => type === 'join')"
            await page.until(f"{joins}.length === 3")
            _, second, third = await page.value(f"{joins}.map(({{ms}}) => ms)")
            assert third - second > 950.0, "the waits are 500, 1,000 and 2,000 ms"

    asyncio.run(asyncio.wait_for(body(), 60))


ORIENTATION = "dispatchEvent(new DeviceOrientationEvent('deviceorientation', {alpha: %d, beta: 0, gamma: 0}))"


async def drag(page, start, by, buttons=1):
    """Drags the mouse, in steps, and holds it at the end."""
    x, y = start
    await page.mouse("mouseMoved", x, y)
    await page.mouse("mousePressed", x, y, buttons=buttons)
    for part in np.linspace(0.1, 1.0, 10):
        await page.mouse("mouseMoved", x + part * by[0], y + part * by[1], buttons=buttons)
        await asyncio.sleep(0.05)


def test_mouse_pads_and_a_phones_orientation_steer(folder, book):
    def turn(session):
        return float(yaw_of(np.array(session.station.hand()["rot"])))

    async def body():
        async with served(book) as (session, url), chromium.browser() as page:
            await page.open(url)
            await page.until("document.querySelector('canvas')?.width === 32")
            await tap(page, "Enter")
            await page.until("document.body.dataset.phase === 'running'")
            image, pads = await page.middle("canvas"), "pad-move"
            x, y, z = session.station.hand()["pos"]
            await drag(page, image, (50, 0))  # right in the image is +y
            await eventually(lambda: session.station.hand()["pos"][1] > y + 0.025)
            await page.mouse("mouseReleased", *image, buttons=1)
            await drag(page, image, (0, -50), buttons=2)
            await eventually(lambda: session.station.hand()["pos"][2] > z + 0.025)
            await page.mouse("mouseReleased", *image, buttons=2)
            before = turn(session)
            await page.mouse("mouseWheel", *image, wheel=100)
            await eventually(lambda: abs(turn(session) - before) > 0.15)

            away, size = await page.middle(f"#{pads}"), 40
            x = session.station.hand()["pos"][0]
            await page.mouse("mousePressed", away[0], away[1] + size, buttons=1)  # towards the camera: +x
            await eventually(lambda: session.station.hand()["pos"][0] > x + 0.02)
            await page.mouse("mouseReleased", *away, buttons=1)

            before = turn(session)
            await page.value("document.getElementById('phone').click()")
            await page.mouse("mousePressed", *away, buttons=1)  # the middle of a pad: held, and no motion
            await page.until(f"document.getElementById('{pads}').classList.contains('held')")
            await page.value(ORIENTATION % 350)
            sent = 0
            while turn(session) - before < math.radians(15):
                assert sent < 170, await page.value("document.body.dataset.phase")
                sent += 5
                await page.value(ORIENTATION % ((350 + sent) % 360))
                await asyncio.sleep(0.1)
            await page.mouse("mouseReleased", *away, buttons=1)
            await asyncio.sleep(0.5)
            stopped = turn(session)
            assert stopped - before < math.radians(sent + 5)
            await page.value(ORIENTATION % 90)  # no pad is held
            await asyncio.sleep(0.3)
            assert turn(session) == pytest.approx(stopped, abs=0.01)
            assert set(session._devices) >= {"mouse", "phone"}
            assert not page.problems, page.problems

    asyncio.run(asyncio.wait_for(body(), 150))
