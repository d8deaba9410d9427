"""The command as a process: its address, its page, and Ctrl+C."""

import re
import signal
import subprocess
import sys
import urllib.request

import pytest


@pytest.mark.slow
def test_the_command_prints_an_address_and_ends_with_a_report_when_interrupted(tmp_path):
    words = ["task=PickCube", "view_size=32", "view_cameras=[front]", "port=0", f"datasets_dir={tmp_path}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "roboverse_learn.cli", "teleoperate", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        line = next(line for line in process.stderr if "Open " in line)
        (url,) = re.findall(r"http://127\.0\.0\.1:\d+/[\w-]{22}/", line)
        with urllib.request.urlopen(url, timeout=30) as page:
            assert b"Teleoperation" in page.read()
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, error
    assert "Interrupted: 0 successes are recorded." in error and "Traceback" not in error
    assert "Episodes: 0 success, 0 failure, 0 discarded" in out
    assert "roboverse collect source=teleop path=" in out.replace("\n", "")
