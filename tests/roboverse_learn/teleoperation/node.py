"""Node: evaluates the page's functions, or runs the whole page against a server, with a test's headset."""

import asyncio
import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import AsyncIterator
from importlib import resources
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("node")

BROWSER = Path(__file__).parent / "browser.mjs"


def page_folder(folder: Path) -> Path:
    """Copies the page's scripts to where Node takes them for modules."""
    files = resources.files("roboverse_learn.teleoperation") / "page"
    for file in files.iterdir():
        if file.name.endswith(".js"):
            (folder / file.name).write_bytes(file.read_bytes())
    (folder / "package.json").write_text('{"type": "module"}')
    return folder


def evaluated(folder: Path, module: str, expression: str) -> Any:
    """Returns an expression's value, in which ``m`` is a module of the page."""
    code = f"import * as m from '{(folder / module).as_uri()}'; console.log(JSON.stringify({expression}));"
    words = ["node", "--input-type=module", "--eval", code]
    result = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def has_websocket() -> bool:
    """Returns whether Node has a client of websockets: from version 20.10 on."""
    if PROGRAM is None:
        return False
    words = [
        PROGRAM,
        "--experimental-websocket",
        "--eval",
        "process.exit(typeof WebSocket === 'function' ? 0 : 1)",
    ]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


class NodePage:
    """The page, as it runs in Node."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def value(self, expression: str) -> Any:
        """Evaluates an expression in the page."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(expression).encode() + b"\n")
        answer = await asyncio.wait_for(self._process.stdout.readline(), 30)
        if not answer:
            assert self._process.stderr is not None
            raise AssertionError((await self._process.stderr.read()).decode())
        return json.loads(answer)

    async def until(self, expression: str, seconds: float = 30.0) -> None:
        """Waits until an expression is true."""
        async with asyncio.timeout(seconds):
            while not await self.value(expression):
                await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def opened(url: str, folder: Path, certificate: Path | None = None) -> AsyncIterator[NodePage]:
    """Opens an address, over https with a certificate that is trusted."""
    trust = {} if certificate is None else {"NODE_EXTRA_CA_CERTS": str(certificate)}
    process = await asyncio.create_subprocess_exec(
        "node",
        "--no-warnings",
        "--experimental-websocket",
        str(BROWSER),
        str(page_folder(folder)),
        url,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, **trust},
    )
    try:
        yield NodePage(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
