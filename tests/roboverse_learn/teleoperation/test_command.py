"""The command as a process: its address, its page, and Ctrl+C."""

import os
import re
import signal
import time
import urllib.request

import pytest

from tests import imported_process


@pytest.mark.slow
def test_the_command_prints_an_address_and_ends_with_a_report_when_interrupted(tmp_path):
    words = ["task=PickCube", "view_size=32", "view_cameras=[front]", "port=0", f"datasets_dir={tmp_path}"]
    out, error = tmp_path / "out", tmp_path / "err"
    process = imported_process.start(
        imported_process.COMMAND, "teleoperate", *words, folder=tmp_path, out=out, err=error
    )
    try:
        while not (urls := re.findall(r"Open .*(http://127\.0\.0\.1:\d+/[\w-]{22}/)", text_of(error))):
            assert process.is_alive(), text_of(error)
            time.sleep(0.02)
        (url,) = urls
        with urllib.request.urlopen(url, timeout=30) as page:
            assert b"Teleoperation" in page.read()
        assert process.pid is not None
        os.kill(process.pid, signal.SIGINT)
        process.join(60)
    finally:
        process.kill()
        process.join()
    assert process.exitcode == 0, text_of(error)
    assert "Interrupted: 0 successes are recorded." in text_of(error) and "Traceback" not in text_of(error)
    assert "Episodes: 0 success, 0 failure, 0 discarded" in text_of(out)
    assert "recordings" in text_of(out) and "Render them again" not in text_of(out), "there are none"


def text_of(file):
    return file.read_text() if file.exists() else ""
