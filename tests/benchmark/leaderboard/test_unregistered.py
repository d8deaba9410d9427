"""A folder of results with some of a channel or level that only a plugin registers."""

import json

import pytest

from benchmark.leaderboard.build import build, write
from benchmark.leaderboard.results_folder import check_results_folder
from benchmark.protocol import Protocol
from benchmark.results import read_result
from benchmark.suites import SuiteResult, write_suite
from benchmark.unregistered import check_registered
from envs.core.errors import ResultError, UnregisteredError
from envs.core.registry import Registry

COMMAND = "python roboverse_learn/evaluate.py policy=expert 'plugins=[my_tint]' levels=[]"


@pytest.fixture
def of_plugin(publish, tmp_path, monkeypatch):
    """A result beside another one, and its suite, in a process that lacks the plugin of its channels."""
    channels, levels = Registry("channel"), Registry("level")
    for name in ("task", "camera"):
        channels.add(name, object)
    with monkeypatch.context() as patch:
        for module in ("envs.randomization.levels", "benchmark.unregistered"):
            patch.setattr(f"{module}.CHANNELS", channels)
            patch.setattr(f"{module}.NAMED_LEVELS", levels)
        channels.add("tint", object)
        levels.add("tinted", ("camera", "tint"))
        protocol = Protocol(levels=(), only=("camera+tint", "tinted"), episodes=4)
        path = publish(protocol=protocol, policy="diffusion", command=COMMAND)
        inside = path.relative_to(tmp_path).as_posix()
        suite = SuiteResult(
            suite="two", named_protocol="", policy="diffusion", run="diffusion-s0", created="2026",
            protocol=protocol, tasks=("PickCube",), results={"PickCube": inside}, failed={},
        )  # fmt: skip
        write_suite(tmp_path, suite, {"PickCube": read_result(path)})
    publish()
    return path


def test_results_of_a_plugin_are_left_out_of_the_board_with_a_warning(of_plugin, tmp_path, caplog):
    written = write(tmp_path)
    (section,) = json.loads(written["json"].read_text())["sections"]
    assert [row["policy"] for row in section["rows"]] == ["act"]
    record, of_suite = caplog.records
    assert "without a row of a suite" in of_suite.getMessage() and "'tint'" in of_suite.getMessage()
    assert record.levelname == "WARNING" and "without 1 results file" in record.getMessage()
    said = f"'{of_plugin}' names the channel or level 'tint', which is not registered here. Add plugins=[my_t"
    assert said in record.getMessage()
    assert of_plugin.is_file()


def test_a_folder_with_results_of_plugins_alone_is_an_empty_board(of_plugin, tmp_path):
    for path in tmp_path.glob("v2/PickCube/act/*.json"):
        path.unlink()
    check_results_folder(tmp_path)
    assert build(tmp_path)["sections"] == []


@pytest.mark.parametrize(
    ("command", "word"),
    [
        (COMMAND.replace("my_tint", "a, b.c"), "plugins=[a, b.c]"),
        ("roboverse evaluate plugins=my_tint", "plugins=my_tint"),
        ("roboverse evaluate", "plugins=[<module>]"),
        ("roboverse 'evaluate", "plugins=[<module>]"),
        ("roboverse 'plugins=[a]; rm'", "plugins=[<module>]"),
    ],
)
def test_the_plugins_are_those_of_the_command_that_wrote_the_file(tmp_path, command, word):
    document = {"protocol": {"only": ["camera", "tint"]}, "command": command}
    with pytest.raises(UnregisteredError) as caught:
        check_registered(tmp_path, document)
    assert f"Add {word}, or install the package that has it." in str(caught.value)


def test_a_file_in_which_the_name_of_a_channel_was_changed_is_damaged(publish, tmp_path):
    path = publish(protocol=Protocol(only=("camera",), episodes=4))
    path.write_text(path.read_text().replace('"camera"', '"camxra"'))
    with pytest.raises(ResultError, match=r"No leaderboard was written.*\n.*Unknown channel 'camxra'"):
        write(tmp_path)


def test_a_level_that_cannot_be_imported_is_named_with_the_file_and_leaves_the_others(
    of_plugin, tmp_path, monkeypatch, caplog
):
    levels = Registry("level")
    levels.add("tinted", "module_that_is_absent:TINTED", distribution="theirs")
    for module in ("envs.randomization.levels", "benchmark.unregistered"):
        monkeypatch.setattr(f"{module}.NAMED_LEVELS", levels)
    document = json.loads(of_plugin.read_text())
    with pytest.raises(
        UnregisteredError, match=rf"'{of_plugin}': The level 'tinted' of the package 'theirs'"
    ):
        check_registered(of_plugin, {"protocol": {"only": ["tinted"]}, "command": document["command"]})
    assert [row["policy"] for row in build(tmp_path)["sections"][0]["rows"]] == ["act"]
    assert str(of_plugin) in caplog.text
