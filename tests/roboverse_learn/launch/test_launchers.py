"""What every launcher keeps, and one of another package."""

from dataclasses import dataclass, fields, is_dataclass

import pytest

from envs.core.errors import UnknownNameError
from roboverse_learn.launch import LAUNCHERS, make_launcher
from roboverse_learn.launch.base import Launcher
from roboverse_learn.sweep import plan, sweep


@pytest.mark.parametrize("name", LAUNCHERS.names())
def test_settings_have_defaults_and_a_line_of_help_each(name):
    settings = LAUNCHERS.get(name).settings_class
    assert is_dataclass(settings) and settings() == settings()
    assert isinstance(make_launcher(name, {}), Launcher)
    for field in fields(settings):
        assert f"    {field.name}: " in settings.__doc__


@dataclass(frozen=True)
class QueueSettings:
    """Settings of a launcher of another package.

    Attributes:
        queue: Name of the queue.
    """

    queue: str = "all"


class OtherLauncher(Launcher):
    settings_class = QueueSettings
    ran: list[tuple[str, str]]

    def run(self, jobs, logs, on_end):
        assert logs.is_dir()
        type(self).ran = [(self.settings.queue, job.command) for job in jobs]
        for job in jobs:
            on_end(job, 0)
        return dict.fromkeys((job.name for job in jobs), 0)


def test_a_launcher_of_another_package_runs_a_sweep(tmp_path, monkeypatch):
    monkeypatch.setitem(LAUNCHERS._entries, "other", None)
    del LAUNCHERS._entries["other"]  # and again at the end
    LAUNCHERS.add("other", OtherLauncher)
    words = ["policy=tdmpc2", "seed=0,1", f"runs_dir={tmp_path}", f"results_dir={tmp_path}/results"]
    own = ["launcher=other", "launcher_settings.queue=night"]
    assert sweep(plan([*words, *own])) == "2 runs are complete, 0 of them were before."
    assert [queue for queue, _ in OtherLauncher.ran] == ["night", "night"]
    assert OtherLauncher.ran[1][1].startswith("roboverse train policy=tdmpc2 seed=1")
    with pytest.raises(UnknownNameError, match=r"launcher=other 'qeue'\. Did you mean 'queue'"):
        plan([*words, "launcher=other", "launcher_settings.qeue=night"])
