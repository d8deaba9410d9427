"""SIGTERM ends a command as Ctrl-C does: one line, its own exit code, no process left, whole datasets."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from roboverse_learn import cli, view
from roboverse_learn.commands.sigterm import sigterm_interrupts
from roboverse_learn.data import DatasetInfo, recover
from roboverse_learn.training.interruption import Interrupted

ROOT = Path(__file__).resolve().parents[3]

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGTERM of another process")


def ends_by_sigterm(*_: object) -> None:
    signal.raise_signal(signal.SIGTERM)


def test_it_raises_and_the_handler_is_gone_afterwards() -> None:
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL, "importing the command line installs none"
    with pytest.raises(Interrupted, match="SIGTERM") as raised, sigterm_interrupts():
        ends_by_sigterm()
    assert raised.value.exit_code == 143
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda *_: None])
def test_a_handler_of_somebody_else_stays(handler: signal.Handlers) -> None:
    before = signal.signal(signal.SIGTERM, handler)
    try:
        with sigterm_interrupts():
            ends_by_sigterm()
            assert signal.getsignal(signal.SIGTERM) is handler
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_command_says_so_and_ends_with_143(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "_run", ends_by_sigterm)
    assert cli.main(["leaderboard"]) == 143
    said = capsys.readouterr().err
    assert said.strip() == "Interrupted. What is saved stays: the same command continues from there."
    assert cli.main(["doctor"]) == 143
    assert capsys.readouterr().err.strip() == "Interrupted.", "it saves nothing"


def test_a_viewer_that_waits_is_ended_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view.time, "sleep", ends_by_sigterm)
    with pytest.raises(Interrupted, match="SIGTERM"), sigterm_interrupts():
        view._wait()


FORKED = """
import os, signal, sys
from roboverse_learn.commands.sigterm import sigterm_interrupts
with sigterm_interrupts():
    child = os.fork()
    if not child:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            signal.pause()
        finally:
            os._exit(5)
    sys.exit(os.WTERMSIG(os.waitpid(child, 0)[1]))
"""


def test_a_process_that_was_forked_ends_at_once() -> None:
    done = subprocess.run([sys.executable, "-c", FORKED], cwd=ROOT, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (signal.SIGTERM, b"")


@pytest.mark.slow
@pytest.mark.parametrize("group", [False, True], ids=["this-process", "its-group"])
def test_a_collection_ends_with_its_workers_and_keeps_its_episodes(tmp_path: Path, group: bool) -> None:
    words = ["collect", "task=PickCube", "preset=quick", "num_demos=500", "num_workers=2", "num_envs=2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "roboverse_learn", *words, f"dataset={tmp_path}/d"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    info = tmp_path / "d/meta/info.json"
    while not (info.exists() and json.loads(info.read_text())["total_episodes"]):
        assert process.poll() is None
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    (os.killpg if group else os.kill)(process.pid, signal.SIGTERM)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert said.endswith("\nInterrupted. What is saved stays: the same command continues from there.\n"), said
    assert "Traceback" not in said and "Terminated" not in said
    assert not psutil.wait_procs(children, 20)[1]
    assert DatasetInfo.open(tmp_path / "d").num_episodes == recover(tmp_path / "d") >= 1
