"""Counts of experts that listings read."""

import json
import subprocess
import sys

import pytest

from envs.core.errors import ConfigError
from envs.experts import counts
from envs.tasks import TASKS


def test_only_what_was_counted_is_returned(tmp_path, monkeypatch):
    path = tmp_path / "tasks.json"
    rows = {
        "a": {"expert": 0.9, "episodes": 20, "mean_steps": 61.5},
        "b": {"make_s": 1.0},
        "c": {"error": "no file"},
    }
    path.write_text(json.dumps(rows))
    monkeypatch.setattr(counts, "CHECKOUT", path)
    assert counts.read_counts() == {"a": counts.ExpertCount(20, 0.9, 61.5)}


def test_a_count_is_printed_in_percent_without_zeros():
    assert str(counts.ExpertCount(500, 0.998, 60.0)) == "99.8 % of 500"
    assert str(counts.ExpertCount(20, 1.0, 60.0)) == "100 % of 20"


def test_the_file_in_the_repository_has_registered_tasks_and_no_local_paths():
    rows = counts.read_rows(counts.CHECKOUT)
    assert set(rows) <= set(TASKS) and counts.read_counts()
    for row in rows.values():
        assert row["command"].startswith("python -m envs.experts.survey") and "=/" not in row["command"]
        assert "error" not in row
        if row.get("episodes"):
            assert row["episodes"] >= 20 and 0.0 <= row["expert"] <= 1.0


def test_the_file_of_an_installed_package_comes_before_a_checkout(tmp_path, monkeypatch):
    assert counts.counts_file() == counts.CHECKOUT
    packaged = tmp_path / "tasks.json"
    packaged.write_text("{}")
    monkeypatch.setattr(counts, "PACKAGED", packaged)
    assert counts.counts_file() == packaged and counts.read_counts() == {}


def test_without_a_file_nothing_is_counted(tmp_path):
    assert counts.read_rows(tmp_path / "none.json") == {}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"a": 3}'])
def test_a_damaged_file_is_named(tmp_path, text):
    path = tmp_path / "tasks.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"tasks\.json has no rows of tasks .*Restore it"):
        counts.read_rows(path)


@pytest.mark.slow
def test_listing_counts_imports_no_torch():
    code = "import sys, envs.experts.counts as c; c.read_counts(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
