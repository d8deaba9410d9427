"""The page and the websocket, with well-behaved clients and with hostile ones."""

import asyncio
import contextlib
import io
import json
import os
import socket
import threading

import aiohttp
import pytest
from aiohttp import web

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from roboverse_learn.teleoperation.conductor import Conductor
from roboverse_learn.teleoperation.recording import Mark
from roboverse_learn.teleoperation.server import FRAMES_ON_THE_WAY, OPENED_AGAIN, TeleoperationServer
from roboverse_learn.teleoperation.session import Phase
from tests.roboverse_learn.teleoperation.scripted_client import Client, Follower, play


class Site:
    """A server with sessions that tick at the control rate, and no images."""

    def __init__(self, sessions, **facts):
        self.sessions = sessions
        self.server = TeleoperationServer(sessions, {"task": "PickCube", "cameras": ["front"], **facts})
        self.port = 0

    async def __aenter__(self):
        self.port = await self.server.start("127.0.0.1", 0)
        self._ticking = asyncio.create_task(self._tick())
        self.http = aiohttp.ClientSession()
        return self

    async def __aexit__(self, *_):
        self._ticking.cancel()
        await self.http.close()
        await self.server.stop()

    async def _tick(self):
        while True:
            for index, session in enumerate(self.sessions):
                session.tick()
                self.server.send_status(index, session.status())
            await asyncio.sleep(0.05)

    def url(self, path="", token=None):
        return f"http://127.0.0.1:{self.port}/{self.server.token if token is None else token}/{path}"

    @contextlib.asynccontextmanager
    async def client(self, name="client", **options):
        async with self.http.ws_connect(self.url("ws"), **options) as opened:
            client = Client(opened)
            await client.join(name)
            yield client


def run(body):
    """Runs a coroutine function, within a minute."""
    asyncio.run(asyncio.wait_for(body(), 60))


def test_the_page_is_served_to_those_with_the_token_alone_and_names_no_other_host(make_session):
    async def body():
        async with Site([make_session()]) as site:
            for name, kind in (("", "html"), ("style.css", "css"), ("page.js", "javascript")):
                async with site.http.get(site.url(name)) as answer:
                    assert answer.status == 200 and kind in answer.content_type
                    text = await answer.text()
                    assert "https://" not in text and "http://" not in text
                    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
                    assert answer.headers["Referrer-Policy"] == "no-referrer"
            for url in (
                *(site.url(name, token="x" * 22) for name in ("", "ws", "page.js")),
                f"http://127.0.0.1:{site.port}/",
                site.url("../../etc/passwd"),
                site.url("..%2f..%2fserver.py"),
                site.url("server.py"),
            ):
                async with site.http.get(url) as answer:
                    assert answer.status == 404, url

    run(body)


def test_tokens_are_random_and_long(make_session):
    session = make_session()
    tokens = {TeleoperationServer([session], {}).token for _ in range(8)}
    assert len(tokens) == 8 and all(len(token) >= 22 for token in tokens)


def test_an_operator_who_comes_back_finds_the_episode_paused_and_continues(make_session):
    session = make_session()

    async def body():
        async with Site([session]) as site:
            async with site.client("ada") as client:
                await client.until("status", phase="ready")
                assert client.hello["operators"] == 1
                await client.say(type="press", button="start")
                for _ in range(6):
                    await client.move([0.2, 0, 0, 0, 0, 0], 1.0)
                    await client.until("status")
            steps = session.step
            assert steps > 2
            await asyncio.sleep(0.2)
            assert session.phase is Phase.PAUSED and session.step == steps
            async with site.client("ada") as client:
                await client.until("status", phase="paused")
                await client.say(type="press", button="start")
                await client.until("status", phase="running")
                await client.move([0.2, 0, 0, 0, 0, 0], 1.0)
                while session.step <= steps:
                    await client.until("status")

    run(body)


def test_each_operator_has_an_environment_and_one_too_many_is_reported(make_session):
    sessions = [make_session(0), make_session(1)]

    async def body():
        async with Site(sessions) as site, site.client("a") as one, site.client("b") as other:
            await one.until("hello")
            await other.until("hello")
            assert {one.hello["operator"], other.hello["operator"]} == {0, 1}
            async with site.client("c") as third:
                assert await third.read() == "full"
            # The page opened again is the same operator's, and the older one is closed.
            async with site.client("a") as again:
                await again.until("hello")
                assert again.hello["operator"] == one.hello["operator"]
                assert await closed_by_server(one.socket) == OPENED_AGAIN == 4001

    run(body)


def test_an_operator_who_goes_before_the_first_word_leaves_the_environment_free(make_session, monkeypatch):
    session = make_session()
    say = web.WebSocketResponse.send_str

    async def lost(self, *_, **__):
        raise aiohttp.ClientConnectionResetError("Cannot write to closing transport")

    async def body():
        async with Site([session]) as site:
            monkeypatch.setattr(web.WebSocketResponse, "send_str", lost)
            async with site.http.ws_connect(site.url("ws")) as opened:
                await Client(opened).join("ada")
                await closed_by_server(opened)
            assert not session.connected
            monkeypatch.setattr(web.WebSocketResponse, "send_str", say)
            async with site.client("grace") as client:
                assert await client.read() == "hello"

    run(body)


async def closed_by_server(opened, seconds=10.0):
    """Returns the code with which the server closes a websocket."""
    async with asyncio.timeout(seconds):
        async for _ in opened:
            pass
    return opened.close_code


HOSTILE = {
    "garbage": lambda ws: ws.send_str("\x00\xff not json"),
    "bytes": lambda ws: ws.send_bytes(os.urandom(1000)),
    "nested": lambda ws: ws.send_str("[" * 1900),
    "giant": lambda ws: ws.send_str("x" * 1_000_000),
    "move before join": lambda ws: ws.send_str('{"type":"move"}'),
    "infinite": lambda ws: ws.send_str('{"type":"join","client":"a","operator":1e999}'),
}


def test_hostile_clients_are_closed_and_the_operator_notices_nothing(make_session):
    session = make_session()

    async def flood(site):
        async with site.http.ws_connect(site.url("ws")) as opened:
            await opened.send_str('{"type":"join","client":"ada"}')  # pretends to be the operator
            with contextlib.suppress(ConnectionError):
                for _ in range(5000):
                    await opened.send_str('{"type":"press","button":"pause"}')
            return await closed_by_server(opened)

    async def body():
        async with Site([session, make_session(1)]) as site, site.client("operator") as client:
            await client.until("status", phase="ready")
            for name, attack in HOSTILE.items():
                async with site.http.ws_connect(site.url("ws")) as opened:
                    with contextlib.suppress(ConnectionError):
                        await attack(opened)
                    assert await closed_by_server(opened) in (1002, 1006, 1008, 1009), name
            assert await flood(site) in (1006, 1008)
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await site.http.ws_connect(site.url("ws", token="guess"))
            assert refused.value.status == 404
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await site.http.ws_connect(site.url("ws"), origin="https://elsewhere.example")
            assert refused.value.status == 403
            async with site.http.post(site.url(), data=io.BytesIO(b"x" * 1_000_000)) as answer:
                assert answer.status in (404, 405, 413)
            await client.say(type="press", button="start")
            await client.until("status", phase="running")
            await client.move([0.2, 0, 0, 0, 0, 0], 1.0)
            await client.until("status", step=2)
            assert session.connected

    run(body)


@pytest.mark.slow
def test_more_sockets_than_operators_need_are_refused_until_one_leaves(make_session, monkeypatch):
    monkeypatch.setattr("roboverse_learn.teleoperation.server.JOIN_S", 1.0)

    async def body():
        async with Site([make_session()]) as site, contextlib.AsyncExitStack() as stack:
            idle = [await stack.enter_async_context(site.http.ws_connect(site.url("ws"))) for _ in range(5)]
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await site.http.ws_connect(site.url("ws"))
            assert refused.value.status == 503
            assert await closed_by_server(idle[0]) == 1008  # it never joined
            async with site.client() as client:
                await client.until("hello")

    run(body)


@pytest.mark.slow
def test_half_open_connections_are_closed(make_session, monkeypatch):
    monkeypatch.setattr("roboverse_learn.teleoperation.server.SILENCE_S", 0.3)

    async def body():
        async with Site([make_session()]) as site:
            address = ("127.0.0.1", site.port)
            pairs = [await asyncio.open_connection(*address) for _ in range(3)]
            pairs[-1][1].write(f"GET /{site.server.token}/ HTTP/1.1\r\nHost: x\r\nX-Half: ".encode())
            for reader, writer in pairs:
                async with asyncio.timeout(5):
                    with contextlib.suppress(ConnectionError):
                        assert await reader.read() == b""
                writer.close()
            async with site.http.get(site.url()) as answer:
                assert answer.status == 200

    run(body)


def test_a_browser_that_does_not_answer_gets_few_frames_and_the_newest_later(make_session):
    session = make_session()

    async def body():
        from roboverse_learn.teleoperation.conductor import Frame

        async with Site([session]) as site, site.client() as client:
            await client.until("hello")
            for number in range(30):
                site.server.show(0, Frame(number=number, seq=0, step=number, jpegs={"front": b"jpeg"}))
                await asyncio.sleep(0.01)
            with contextlib.suppress(TimeoutError):
                while True:
                    await client.read(0.3)
                    if client.frames and client.frames[-1]["step"] == 29:
                        break
            early = [frame for frame in client.frames if frame["step"] < 29]
            assert len(early) <= FRAMES_ON_THE_WAY
            await client.move([0.0] * 6, 1.0)  # says what it has seen
            async with asyncio.timeout(5):
                while client.frames[-1]["step"] != 29:
                    await client.read()

    run(body)


def test_a_taken_port_is_reported(make_session):
    async def body():
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            server = TeleoperationServer([make_session()], {})
            with pytest.raises(ConfigError, match=f"port={port}: .*Choose another port"):
                await server.start("127.0.0.1", port)

    run(body)


@pytest.mark.slow
def test_a_scripted_client_plays_pick_cube_through_the_protocol(folder, book, pick_cube):
    from roboverse_learn.teleoperation.session import Session
    from roboverse_learn.teleoperation.station import Station

    env = EnvSpec(task="PickCube", image_size=32).make(1, num_threads=1)
    drawing = threading.Lock()
    session = Session(Station(env, 0, drawing), book, limit_s=30.0)

    async def body():
        server = TeleoperationServer([session], {"task": "PickCube"})
        conductor = Conductor(
            env, [session], drawing=drawing, on_status=server.send_status, on_frame=server.show
        )
        port = await server.start("127.0.0.1", 0)
        await asyncio.to_thread(conductor.start)
        try:
            async with (
                aiohttp.ClientSession() as http,
                http.ws_connect(f"http://127.0.0.1:{port}/{server.token}/ws") as opened,
            ):
                client = Client(opened)
                await client.join(operator="Ada")
                await client.until("status", phase="ready")
                await play(client, Follower(pick_cube))
                assert client.jpeg.startswith(b"\xff\xd8") and len(client.frames) > 5
                steps = [frame["step"] for frame in client.frames]
                assert max(steps) > 20
        finally:
            conductor.stop()
            await server.stop()
        assert conductor.error is None
        assert conductor.figures().ticks > 20

    try:
        run(body)
    finally:
        env.close()
    (facts,) = folder.facts.values()
    assert facts["mark"] == Mark.SUCCESS, json.dumps(facts)
    assert (facts["operator"], facts["device"]) == ("Ada", "script")
