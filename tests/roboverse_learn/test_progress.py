"""What a long stage shows: a bar in a terminal, lines elsewhere."""

import logging
import re
import time
from io import StringIO

import pytest
from rich.console import Console

from roboverse_learn.data.collection.collect import CollectionProgress
from roboverse_learn.progress import StageProgress, clock


def run_stage(console: Console, updates: int = 2) -> None:
    with StageProgress("collecting", console, interval_s=0.02) as progress:
        for done in range(updates):
            progress.update(10 * done, 40, "71 frames/s")
        time.sleep(0.2)


@pytest.mark.parametrize(("seconds", "shown"), [(0.2, "0:00"), (75, "1:15"), (3700, "1:01:40")])
def test_clock_shows_minutes_and_hours(seconds: float, shown: str) -> None:
    assert clock(seconds) == shown


def test_lines_without_a_terminal_show_count_rate_and_time_left(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    run_stage(Console(file=StringIO()))
    assert caplog.messages
    assert caplog.messages[-1].startswith("collecting 10/40 (25 %), 71 frames/s, 0:00 left, 0:00 elapsed")


def test_lines_come_before_the_first_update(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    run_stage(Console(file=StringIO()), updates=0)
    assert caplog.messages[0] == "collecting starts, 0:00 elapsed"


def test_a_stage_that_ends_before_its_first_line_has_one_at_its_end(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    with StageProgress("collecting", Console(file=StringIO()), interval_s=3600.0) as progress:
        progress.update(0, 4)
        progress.update(4, 4, "71 frames/s")
    (line,) = caplog.messages
    assert line.startswith("collecting 4/4 (100 %), 71 frames/s, 0:00 left, ")


def test_a_stage_without_an_update_ends_without_a_line(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    with StageProgress("collecting", Console(file=StringIO()), interval_s=3600.0):
        pass
    assert not caplog.messages


def test_a_terminal_has_a_bar_and_the_log_the_lines(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "roboverse_learn.progress")
    console = Console(file=StringIO(), force_terminal=True, width=120)
    run_stage(console)
    assert {record.levelno for record in caplog.records} == {logging.DEBUG}
    assert "━" in console.file.getvalue() and "10/40 (25 %)" in console.file.getvalue()


def test_the_time_left_of_the_caller_is_shown(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    with StageProgress("training", Console(file=StringIO()), interval_s=0.02) as progress:
        progress.update(1, 10, left_s=3671.0)
        time.sleep(0.1)
    assert "1:01:11 left" in caplog.messages[-1]


def test_what_is_counted_has_a_rate(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    with StageProgress("evaluating", Console(file=StringIO()), interval_s=0.02) as progress:
        progress.update(3, 43, unit="episodes")
        time.sleep(0.2)
        progress.update(13, 43, unit="episodes")
        while "13/43" not in caplog.text:
            time.sleep(0.02)
    found = re.match(r"evaluating 13/43 \(30 %\), ([\d.]+) episodes/s, 0:\d\d left", caplog.messages[-1])
    assert found
    assert 0 < float(found[1]) <= 50  # ten in a fifth of a second, or longer on a busy machine


def test_what_ends_at_once_has_no_rate(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "roboverse_learn.progress")
    with StageProgress("evaluating", Console(file=StringIO())) as progress:
        progress.update(1, 2, unit="episodes")
        progress.update(2, 2, unit="episodes")
    assert caplog.messages[-1].startswith("evaluating 2/2 (100 %), 0:00 left")


@pytest.mark.parametrize(("num_attempts", "shown"), [(0, "71 frames/s"), (8, "75.0 % succeed, 71 frames/s")])
def test_a_collection_shows_its_success_rate_from_the_first_attempt_on(num_attempts: int, shown: str) -> None:
    progress = CollectionProgress(
        num_episodes=3 * num_attempts // 4,
        target=40,
        num_attempts=num_attempts,
        num_frames=0,
        frames_per_s=71.4,
        remaining_s=None,
    )
    assert progress.rates == shown
