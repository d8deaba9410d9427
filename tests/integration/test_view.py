"""``roboverse view`` of what the main command left: its dataset, its result, and the page in the browser."""

import os
import signal
import socket
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from urllib.parse import unquote

import av
import numpy as np
import pytest

from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.recording import RecordingReader
from tests.imported_process import COMMAND, start
from tests.integration.main_run import MainRun
from tests.viewed import needs_viewer, recorded, view

pytestmark = [pytest.mark.slow, needs_viewer]

EPISODE = 1
NO_DISPLAY = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}


def frames(video: Path) -> np.ndarray:
    """Returns the frames of a video, (T, H, W, 3)."""
    with av.open(str(video)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def assert_alike(shown: np.ndarray, filmed: np.ndarray) -> None:
    """Asserts that images are those of a video, but for what JPEG loses."""
    assert shown.shape == filmed.shape
    assert np.abs(shown.astype(int) - filmed).mean(axis=(1, 2, 3)).max() < 10


def test_an_episode_of_a_dataset_has_its_images_and_states_over_time(
    main_run: MainRun, tmp_path: Path
) -> None:
    words = (f"dataset={main_run.dataset}", f"episode={EPISODE}", "file=demonstration.rrd")
    view(*words, folder=tmp_path, env=NO_DISPLAY)
    found = recorded(tmp_path / "demonstration.rrd")
    info = DatasetInfo.open(main_run.dataset)
    key = "observation.images.front"
    first = round(info.episodes[EPISODE][f"videos/{key}/from_timestamp"] * info.fps)
    length = int(info.episode_lengths[EPISODE])
    assert_alike(found["images"], frames(info.video_file(EPISODE, key))[first : first + length])
    assert np.allclose(found["times"], np.arange(length) / info.fps, atol=1e-6)
    cube = RecordingReader(main_run.dataset).read(EPISODE).states.objects["cube"].pos.numpy()
    assert np.allclose(found["cube"][[0, -1]], cube[[0, -1]], atol=1e-4) and len(found["cube"]) > 10


def test_without_a_display_a_result_is_written_to_a_file(main_run: MainRun, tmp_path: Path) -> None:
    said = view(f"result={main_run.result}", f"episode={EPISODE}", folder=tmp_path, env=NO_DISPLAY)
    assert "Written: view.rrd\nOpen it where there is a display: rerun view.rrd" in said
    found = recorded(tmp_path / "view.rrd")
    (video,) = main_run.result.with_suffix("").glob("level3-*.mp4")
    assert_alike(found["images"], frames(video))
    text = str(found["text"])
    assert "# PickCube, level 3" in text and "by act, " in text and "test split, episode " in text


@pytest.fixture(params=["free", "taken"])
def usual_ports(request: pytest.FixtureRequest) -> Iterator[None]:
    """The ports that the viewer takes where it can: free, or held by another program."""
    with ExitStack() as held:
        for port in (9090, 9876) if request.param == "taken" else ():
            other = held.enter_context(socket.socket())
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with suppress(OSError):  # some other program has it already
                other.bind(("0.0.0.0", port))
                other.listen()
        yield


@pytest.mark.usefixtures("usual_ports")
def test_with_a_display_the_page_opens_in_the_browser_until_ctrl_c(main_run: MainRun, tmp_path: Path) -> None:
    browser, opened, out = tmp_path / "browser", tmp_path / "opened", tmp_path / "printed"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" >"{opened}.part" && mv "{opened}.part" "{opened}"\n')
    browser.chmod(0o755)
    env = os.environ | {"DISPLAY": ":0", "BROWSER": str(browser)}
    process = start(COMMAND, "view", f"dataset={main_run.dataset}", folder=tmp_path, out=out, env=env)
    try:
        while not (opened.exists() and "Ctrl+C" in out.read_text()):
            assert process.is_alive(), out.read_text()
            time.sleep(0.05)
        page = opened.read_text()
        said = unquote("".join(out.read_text().split()))
        assert f"Openinthebrowser,at{unquote(page)}." in said
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(page, timeout=60) as answer:
            assert answer.status == 200 and b"Rerun" in answer.read()
        assert process.pid is not None
        os.kill(process.pid, signal.SIGINT)
        process.join(60)
        assert process.exitcode == 0 and "Closed." in out.read_text()
    finally:
        process.kill()
