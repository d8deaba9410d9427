"""https: real requests to a page with the user's certificate, and with one that is made."""

import asyncio
import contextlib
import shutil
import socket
import ssl
import subprocess

import aiohttp
import pytest

from envs.core.errors import ConfigError
from roboverse_learn.teleoperation.certificate import addresses, fingerprint, self_signed, tls, tls_of
from roboverse_learn.teleoperation.server import TeleoperationServer
from tests.roboverse_learn.teleoperation.scripted_client import Client

needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl makes a certificate")


def visit(session, context, trusted):
    """Opens the page and its websocket over https, as a browser that trusts a certificate."""

    async def body():
        server = TeleoperationServer([session], {"task": "PickCube"})
        port = await server.start("127.0.0.1", 0, context)
        try:
            url = f"https://127.0.0.1:{port}/{server.token}/"
            async with aiohttp.ClientSession() as http:
                async with http.get(url, ssl=trusted) as answer:
                    assert answer.status == 200 and "Teleoperation" in await answer.text()
                origin = f"https://127.0.0.1:{port}"
                async with http.ws_connect(f"{url}ws", ssl=trusted, origin=origin) as opened:
                    client = Client(opened)
                    await client.join()
                    await client.until("hello")
                with pytest.raises(aiohttp.ClientError):  # the port speaks https alone
                    await http.get(url.replace("https", "http"))
            await asyncio.sleep(0.25)  # a session of aiohttp does not wait for the end of TLS
        finally:
            await server.stop()

    asyncio.run(asyncio.wait_for(body(), 60))


@needs_openssl
def test_a_users_certificate_makes_it_https(make_session, tmp_path):
    files = [str(tmp_path / name) for name in ("cert.pem", "key.pem")]
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=robot"]
    words += ["-out", files[0], "-keyout", files[1]]
    subprocess.run(["openssl", *words], check=True, capture_output=True)
    trusted = ssl.create_default_context(cafile=files[0])
    trusted.check_hostname = False
    context = tls_of("127.0.0.1", *files, https=False)
    visit(make_session(), context, trusted)


@needs_openssl
def test_a_certificate_is_made_and_names_the_machine(make_session, tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path))
    context = tls_of("0.0.0.0", "", "", https=True)
    (file,) = (tmp_path / "teleoperation").iterdir()
    trusted = ssl.create_default_context(cafile=str(file))  # checks the name, too
    visit(make_session(), context, trusted)
    assert tls_of("127.0.0.1", "", "", https=False) is None


@needs_openssl
def test_the_made_certificate_is_kept_for_this_user_alone_and_made_again_when_it_ends(tmp_path, monkeypatch):
    names = ["127.0.0.1", "localhost"]
    file = self_signed(names, tmp_path)
    first = file.read_bytes()
    assert file.stat().st_mode & 0o777 == 0o600 and list(tmp_path.iterdir()) == [file]
    assert b"PRIVATE KEY" in first
    file.chmod(0o644)
    assert self_signed(names, tmp_path) == file and file.read_bytes() == first
    assert file.stat().st_mode & 0o777 == 0o600
    assert self_signed([*names, "robot"], tmp_path) != file
    monkeypatch.setattr("roboverse_learn.teleoperation.certificate.DAYS", 1)
    file.write_text("no certificate")
    again = self_signed(names, tmp_path).read_bytes()
    assert again != first and b"PRIVATE KEY" in again
    assert self_signed(names, tmp_path).read_bytes() != again, "it ends within a day"


@needs_openssl
def test_the_fingerprint_is_that_of_openssl(tmp_path):
    file = self_signed(["127.0.0.1"], tmp_path)
    words = ["openssl", "x509", "-in", str(file), "-noout", "-fingerprint", "-sha256"]
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert said.strip().endswith(f"={fingerprint(file)}")


def test_what_is_missing_is_reported(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="Give a certificate and its key, as PEM files"):
        tls("none.pem", "none.key")
    with monkeypatch.context() as patch:
        patch.setattr("shutil.which", lambda _: None)
        with pytest.raises(ConfigError, match=r"with the program openssl, and there is none\. Install it"):
            self_signed(["localhost"], tmp_path)


@needs_openssl
def test_a_name_that_is_none_and_a_folder_that_is_none_are_reported(tmp_path):
    with pytest.raises(ConfigError, match=r"openssl makes no certificate for a,b: .* Give a certificate"):
        self_signed(["a,b"], tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match=r"keeps its certificate as .*none.*Give a certificate"):
        self_signed(["localhost"], tmp_path / "none")


def test_addresses_are_this_machines():
    assert addresses("192.0.2.7") == ["192.0.2.7"]
    found = addresses("0.0.0.0")
    assert found[0] == "127.0.0.1" and len(set(found)) == len(found)
    for address in found:
        with contextlib.closing(socket.socket()) as listening:
            listening.bind((address, 0))  # which only an address of this machine allows
