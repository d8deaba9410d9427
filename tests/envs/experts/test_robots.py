"""The table of robots and tasks: complete after an interruption, and nothing is measured twice."""

import json

import pytest

from envs.core.errors import ConfigError, MissingAssetError
from envs.experts import robots


def cell(robot, task, settings):
    if task == "CloseBox":
        return {"robot": robot, "task": task, "refused": "it lacks 40 mm", "git_sha": None}
    return {"robot": robot, "task": task, "num_episodes": settings.episodes, "num_successes": 3}


@pytest.fixture
def measured(monkeypatch):
    done = []

    def measure(robot, task, settings):
        done.append((robot, task))
        return cell(robot, task, settings)

    monkeypatch.setattr(robots, "measure", measure)
    return done


def test_an_interrupted_table_is_completed(measured, tmp_path, caplog):
    words = [f"out={tmp_path / 'r.json'}", "tasks=[PickCube,CloseBox]", "episodes=5"]
    assert robots.main([*words, "robots=[iiwa]"]) == 0
    assert robots.main([*words, "robots=[iiwa,ur5e]"]) == 0
    pairs = [("iiwa", "PickCube"), ("iiwa", "CloseBox"), ("ur5e", "PickCube"), ("ur5e", "CloseBox")]
    assert measured == pairs
    assert len(json.loads((tmp_path / "r.json").read_text())["cells"]) == 4
    assert robots.main([words[0], words[1], "robots=[iiwa]", "episodes=6"]) == 0
    assert measured == [*pairs, ("iiwa", "PickCube")], "more episodes measure a cell again"


def test_the_table_shows_who_cannot(measured, tmp_path):
    robots.main([f"out={tmp_path / 'r.json'}", "tasks=[PickCube,CloseBox]", "robots=[iiwa]"])
    text = robots.as_text(robots.read_table(tmp_path / "r.json"))
    assert text.splitlines()[0] == "| robot | CloseBox | PickCube |"
    assert text.splitlines()[2] == "| iiwa | cannot | 3/50 |"


def test_an_arm_whose_folder_is_absent_is_left_out_unless_it_is_named(monkeypatch, tmp_path, caplog):
    def measure(robot, task, settings):
        if robot.startswith("xarm7"):
            raise MissingAssetError("roboverse assets get xarm7")
        return cell(robot, task, settings)

    monkeypatch.setattr(robots, "measure", measure)
    words = [f"out={tmp_path / 'r.json'}", "tasks=[PickCube]"]
    assert robots.main([*words, "robots=[xarm7]"]) == 2
    assert not (tmp_path / "r.json").exists()
    assert robots.main(words) == 0
    assert "xarm7 PickCube is left out: roboverse assets get xarm7" in caplog.text
    found = {each["robot"] for each in robots.read_table(tmp_path / "r.json")}
    assert {"iiwa", "jaco"} < found and not {"xarm7", "xarm7_2f85"} & found


def test_a_damaged_table_is_an_error(tmp_path):
    (tmp_path / "r.json").write_text("{")
    with pytest.raises(ConfigError, match="is no table of robots"):
        robots.read_table(tmp_path / "r.json")
    assert robots.main([f"out={tmp_path / 'r.json'}", "robots=[iiwa]"]) == 2
