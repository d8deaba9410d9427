"""The command that measures how often the expert succeeds."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.experts.check import ExpertReport, check_expert, main, summarize


def recorded(episode, actions, *, success=True):
    return SimpleNamespace(episode=episode, success=success, actions=np.asarray(actions, np.float32))


def test_report_of_known_episodes():
    """Three episodes of 3, 1 and 2 steps; fingers (column 2) may jump."""
    episodes = [
        recorded(4, [[0.0, 0.0, 0.04], [0.1, 0.0, 0.0], [0.1, -0.25, 0.0]]),
        recorded(9, [[0.0, 0.0, 0.0]], success=False),
        recorded(2, [[1.0, 1.0, 0.0], [1.0, 1.0, 9.0]]),
    ]
    report = summarize(episodes, arm=(0, 1))
    assert report.num_episodes == 3
    assert report.failures == (9,)
    assert report.success_rate == pytest.approx(2 / 3)
    assert report.mean_steps == pytest.approx(2.0)
    assert report.largest_step_rad == pytest.approx(0.25)


def test_an_expert_that_gives_up_at_once_has_failed():
    report = summarize([recorded(7, [], success=False), recorded(8, [[0.0], [0.5]])], arm=(0,))
    assert (report.failures, report.largest_step_rad, report.mean_steps) == ((7,), 0.5, 1.0)


def test_no_episode_is_refused():
    with pytest.raises(ConfigError, match="needs at least one episode, given none"):
        summarize([], arm=(0,))
    with pytest.raises(ConfigError, match="needs at least one episode, given 0"):
        check_expert("PickCube", "train", 0)


@pytest.mark.slow
def test_report_does_not_depend_on_the_number_of_envs():
    reports = [check_expert("PickCube", "test", 6, num_envs=count, num_threads=1) for count in (2, 6)]
    assert reports[0] == reports[1]
    assert reports[0].success_rate == 1.0
    assert 20 < reports[0].mean_steps < 100
    assert 0.0 < reports[0].largest_step_rad < 0.35


def test_command_logs_a_line_per_split(monkeypatch):
    calls = []

    def pretend(task, split, episodes, *, num_envs, simulator):
        assert simulator == "mujoco"
        calls.append((task, split, episodes, num_envs))
        return ExpertReport(episodes, (17,), 42.5, 0.125)

    monkeypatch.setattr("envs.experts.check.check_expert", pretend)
    monkeypatch.setattr("logging.basicConfig", lambda **_: None)
    said = []
    monkeypatch.setattr("envs.experts.check.logger.info", lambda text, *values: said.append(text % values))
    assert main(["episodes=50", "num_envs=8"]) == 0
    assert calls == [("PickCube", "train", 50, 8), ("PickCube", "test", 50, 8)]
    assert said[0] == (
        "PickCube train in mujoco: 98.00 % success (49 of 50 episodes), 42.5 steps on average, "
        "largest joint step 0.125 rad; failed: 17"
    )
    assert main(["split=test"]) == 0
    assert len(calls) == 3


def test_unknown_task_exits_with_code_two(caplog):
    assert main(["task=PickKube", "episodes=1"]) == 2
    assert re.search(r"Unknown task 'PickKube'\. Did you mean 'PickCube'\?", caplog.text)
