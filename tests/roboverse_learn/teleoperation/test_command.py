"""The command as a process: its address, its page, and Ctrl+C."""

import os
import re
import signal
import time
import urllib.request

import pytest

from roboverse_learn.config.compose import compose
from roboverse_learn.teleoperate import teleoperate
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


@pytest.mark.slow
@pytest.mark.parametrize("actor", ["person", "expert"])
def test_a_folder_with_as_many_successes_as_wanted_opens_no_page_and_says_how_to_record_more(
    tmp_path, caplog, actor
):
    steered = ["task=PickCube", "num_demos=1", "view_size=32", "port=0", "render=false"]
    words = [*steered, f"recordings={tmp_path / 'recordings'}"]
    teleoperate(compose("teleoperate", [*words, "actor=expert"]))
    before = sorted(path.name for path in (tmp_path / "recordings").iterdir())
    caplog.set_level("INFO")
    report = teleoperate(compose("teleoperate", [*words, f"actor={actor}"]))
    assert "already holds 1 of 1 successes. Record more with num_demos=2" in caplog.text
    assert "Open http" not in caplog.text
    assert sorted(path.name for path in (tmp_path / "recordings").iterdir()) == before
    assert "recordings" in str(report.renderables[1])
