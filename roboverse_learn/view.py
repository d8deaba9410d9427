"""``python roboverse_learn/view.py task=PickCube level=3``: an episode in the browser."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import logging
import os
import time

from roboverse_learn.config.other_commands import ViewConfig
from roboverse_learn.config.preflight import check_installed, check_materials
from roboverse_learn.training.interruption import Interrupted

log = logging.getLogger(__name__)


def view(config: ViewConfig) -> str:
    """Shows an episode in the browser until interrupted, or writes it to a file; returns what to print.

    Raises:
        MissingExtraError: The viewer is not installed.
        ConfigError: There is no such episode, or no expert.
        DatasetError: There is no dataset, or it holds no raw states.
        ResultError: The results file is damaged, or there are no videos beside it.
    """
    from roboverse_learn.viewer import episodes
    from roboverse_learn.viewer.recording import load_rerun

    load_rerun()
    check_installed(config.env)
    check_materials(config.env.materials)
    if config.dataset:
        recording = episodes.record_dataset(config)
    elif config.result:
        recording = episodes.record_result(config)
    else:
        recording = episodes.record_expert(config)
    try:
        file = config.file or ("" if has_display() else "view.rrd")
        if file:
            recording.write(Path(file))
            return f"Written: {file}\nOpen it where there is a display: rerun {file}"
        log.info("Open in the browser, at %s. Ctrl+C ends it.", recording.serve())
        _wait()
        return "Closed."
    finally:
        recording.close()


def has_display() -> bool:
    """Whether a browser can open here."""
    return not sys.platform.startswith("linux") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def _wait() -> None:
    """Returns when the user interrupts by Ctrl-C.

    Raises:
        Interrupted: SIGTERM arrived.
    """
    try:
        while True:
            time.sleep(1.0)
    except Interrupted:
        raise
    except KeyboardInterrupt:
        return


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("view")
