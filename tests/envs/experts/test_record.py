"""The file of success rates of experts."""

import json

import pytest

from envs.core.errors import ConfigError
from envs.experts import check
from envs.experts.check import ExpertReport
from envs.experts.record import RECORDS, ExpertRecord, SplitRecord, read_records, write_record
from envs.tasks import TASKS

RECORD = ExpertRecord({"train": SplitRecord(50, 0.98, 42.5)}, "python -m envs.experts.check", "abc")


def test_written_records_are_read_back_and_other_tasks_stay(tmp_path):
    path = tmp_path / "new" / "experts.json"
    assert read_records(path) == {}
    write_record("PickCube", RECORD, path)
    other = ExpertRecord({"test": SplitRecord(10, 1.0, 7.0)}, "c", None)
    write_record("Alone", other, path)
    assert read_records(path) == {"PickCube": RECORD, "Alone": other}
    assert list(json.loads(path.read_text())) == ["Alone", "PickCube"]
    assert [entry.name for entry in path.parent.iterdir()] == ["experts.json"]


def test_record_prints_percent_per_split():
    both = {"train": SplitRecord(500, 1.0, 9.0), "test": SplitRecord(500, 0.998, 9.0)}
    assert str(ExpertRecord(both, "", None)) == "100.0 / 99.8 %"


@pytest.mark.parametrize("text", ["{", "[]", '{"PickCube": {"splits": {}}}', '{"PickCube": 3}'])
def test_damaged_file_is_an_error_with_a_remedy(tmp_path, text):
    path = tmp_path / "experts.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"experts\.json does not say .* measure again: python -m envs"):
        read_records(path)
    with pytest.raises(ConfigError):
        write_record("PickCube", RECORD, path)
    assert path.read_text() == text


def test_committed_records_are_of_registered_tasks_without_local_paths():
    records = read_records()
    assert set(records) <= set(TASKS)
    for task, record in records.items():
        assert f"task={task}" in record.command and "/" not in record.command.replace(task, "")
        for split in record.splits.values():
            assert split.num_episodes >= 1 and 0.0 <= split.success_rate <= 1.0


def test_check_records_both_splits_and_its_command(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "check_expert", lambda *_, **__: ExpertReport(50, (17,), 42.48, 0.1))
    monkeypatch.setattr(check, "git_sha", lambda: "abc+")
    path = tmp_path / "experts.json"
    assert check.main(["task=PickCube", "episodes=50", "record=true", f"records={path}"]) == 0
    split = SplitRecord(50, 0.98, 42.5)
    command = "python -m envs.experts.check task=PickCube episodes=50 record=true records=experts.json"
    assert read_records(path) == {"PickCube": ExpertRecord({"train": split, "test": split}, command, "abc+")}
    before = RECORDS.read_bytes() if RECORDS.is_file() else None
    assert check.main(["task=PickCube", "episodes=50"]) == 0
    assert (RECORDS.read_bytes() if RECORDS.is_file() else None) == before
