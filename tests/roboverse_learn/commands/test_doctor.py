"""``roboverse doctor``: every part is reported, also one that fails."""

import importlib
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from envs.core.extras import install_command
from envs.core.registry import Registry
from roboverse_learn import cli, doctor, extras


@pytest.fixture
def without_processes(monkeypatch):
    """Keeps the parts that take seconds from starting their processes."""
    monkeypatch.setattr(doctor, "_in_process", lambda *words: {"asked": " ".join(words)})


@pytest.mark.parametrize("word", ["--json", "json=true"])
def test_json_has_every_part(without_processes, capsys, word):
    assert cli.main(["doctor", word]) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report) == list(doctor.PARTS)
    assert report["system"]["python"].startswith(".".join(map(str, sys.version_info[:3])))
    assert report["packages"]["mujoco"] == "4.0.0"
    assert report["renderers"]["warp"] == {"asked": "render warp"}
    assert not [part for part, facts in report.items() if "failed" in facts]


@pytest.mark.parametrize("words", [[], ["--json"]])
def test_each_process_is_named_before_it_starts_and_the_report_is_as_without(
    monkeypatch, capsys, caplog, words
):
    said = []

    def answer(command, **how):
        said.append([record.getMessage() for record in caplog.records])
        return subprocess.CompletedProcess(command, 0, stdout='{"asked": "all"}\n', stderr="")

    monkeypatch.setattr(doctor.subprocess, "run", answer)
    monkeypatch.setattr(doctor, "_gpu_driver", lambda: "none")
    with caplog.at_level("INFO", "roboverse_learn.doctor"):
        assert cli.main(["doctor", *words]) == 0
    last = [lines[-1] for lines in said if lines and lines[-1].startswith("Looking at")]
    assert last[:3] == [
        f"Looking at {what} …" for what in ("torch and GPUs", "videos", "the renderer filament")
    ]
    assert last[-1] == "Looking at the speed of training …" and len(set(last)) == len(last)
    assert "Looking at" not in capsys.readouterr().out


def test_a_missing_extra_says_how_to_install_it(without_processes, monkeypatch):
    monkeypatch.setattr(extras, "_is_there", lambda name: name != "h5py")
    found = doctor.extras()
    assert found["import"] == f"without h5py; {install_command('import')}"
    assert found["metaworld"] == "installed"


def test_plugins_are_listed_with_the_names_that_two_packages_register(monkeypatch):
    registry = Registry("task")
    registry.add("PickCube", 1)
    registry.add("Lift", "one:Lift", distribution="one")
    registry.add("Push", "one:Push", distribution="one")
    monkeypatch.setattr("envs.tasks.TASKS", registry)
    monkeypatch.setattr(doctor, "_REGISTRIES", ("envs.tasks:TASKS",))
    assert doctor.plugins() == {"one": ["task Lift", "task Push"]}
    registry.add("Lift", "other:Lift", distribution="other")
    said = doctor.plugins()
    assert said["other"] == ["task Lift"]
    assert "the package 'one' (one:Lift), and by the package 'other' (other:Lift)" in said["registered twice"]


def test_doctor_looks_at_every_registry_that_packages_add_to():
    places = (place.partition(":") for place in doctor._REGISTRIES)
    groups = {getattr(importlib.import_module(module), name).group for module, _, name in places}
    page = Path(__file__).parents[3].joinpath("docs/plugins.md").read_text(encoding="utf-8")
    assert groups == set(re.findall(r"^\| `(roboverse\.\w+)`", page, flags=re.MULTILINE))


def test_a_part_that_fails_leaves_the_others(without_processes, monkeypatch, capsys):
    monkeypatch.setitem(doctor.PARTS, "packages", lambda: 1 / 0)
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "Packages:\n  failed  ZeroDivisionError: division by zero" in said
    assert "System:" in said and "Speed:" in said


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("import os; os.abort()", "exit code -6"),
        ("import sys; sys.exit('no driver')", "exit code 1: no driver"),
        ("import time; time.sleep(60)", "no answer within 0.5 s"),
    ],
)
def test_a_process_that_crashes_or_hangs_is_a_reason(monkeypatch, program, reason):
    real = subprocess.run
    monkeypatch.setattr(doctor, "_PROBE_LIMIT_S", 0.5 if "sleep" in program else 60.0)
    monkeypatch.setattr(
        doctor.subprocess, "run", lambda command, **how: real([sys.executable, "-c", program], **how)
    )
    started = time.monotonic()
    assert reason in doctor._guarded(lambda: doctor._in_process("render", "warp"))["failed"]
    assert time.monotonic() - started < 30


@pytest.mark.parametrize("percent", [97.0, 3.0])
def test_a_speed_that_takes_too_long_is_no_failure_on_a_busy_machine(monkeypatch, percent):
    real = subprocess.run
    monkeypatch.setattr(doctor, "_PROBE_LIMIT_S", 0.1)
    monkeypatch.setattr(psutil, "cpu_percent", lambda interval: percent)
    monkeypatch.setattr(
        doctor.subprocess,
        "run",
        lambda _, **how: real([sys.executable, "-c", "import time; time.sleep(60)"], **how),
    )
    said = doctor.as_text({"speed": doctor.speed()})
    assert ("machine is busy" in said and "other programs use 97 % of the processor" in said) == (
        percent > 50
    )
    assert said.count("slow no answer within 0.1 s") == (2 if percent > 50 else 0)
    assert said.count("failed no answer within 0.1 s") == (0 if percent > 50 else 2)


@pytest.mark.slow
def test_the_default_renderer_and_the_videos_work_here():
    assert doctor._in_process("render", "warp")["64×64 images/s"] > 0
    assert doctor._in_process("video")["pyav"] == {"decodes": "4 frames"}


@pytest.mark.slow
def test_a_renderer_that_does_not_exist_is_a_reason():
    assert "Unknown renderer" in doctor._in_process("render", "wrap")["failed"]


def last_line(capsys, *words):
    assert cli.main(["doctor", *words]) == 0
    return capsys.readouterr().out.rstrip("\n").split("\n")[-1]


@pytest.fixture
def all_installed(monkeypatch):
    monkeypatch.setitem(doctor.PARTS, "extras", lambda: {"newton": "installed"})


def fail(*failing):
    """Returns a stand-in for processes of which those whose words are named fail."""
    return lambda *words: {"failed": "no driver."} if words[:2] in failing else {"steps/s": 1.0}


def test_the_last_line_says_that_the_default_path_works(without_processes, all_installed, capsys):
    assert last_line(capsys) == "The default path works."


@pytest.mark.parametrize(
    ("failing", "reason"),
    [
        (("render", "warp"), "renderer=warp: no driver"),
        (("train",), "train (act, preset=quick, device=auto): no driver"),
        (("torch",), "torch: no driver"),
        (("video",), "videos: no driver"),
    ],
)
def test_the_last_line_says_why_the_default_path_does_not_work(
    all_installed, monkeypatch, capsys, failing, reason
):
    monkeypatch.setattr(doctor, "_in_process", fail(failing))
    assert last_line(capsys) == f"The default path does not work, because of {reason}."


def test_the_last_line_names_what_is_optional_and_not_usable(monkeypatch, capsys):
    monkeypatch.setitem(doctor.PARTS, "extras", lambda: {"newton": "without newton; pip", "dev": "installed"})
    processes = fail(("render", "gl"), ("render", "newton"), ("render", "sapien"))
    monkeypatch.setattr(doctor, "_in_process", processes)
    optional = "optional and not usable here: renderers gl, sapien; extras newton."
    assert last_line(capsys) == f"The default path works; {optional}"
    monkeypatch.setattr(doctor, "_in_process", fail(("render", "gl"), ("env",)))
    said = last_line(capsys)
    assert (
        said.startswith("The default path does not work, because of env (") and "renderers gl; extras" in said
    )


def test_a_speed_that_a_busy_machine_does_not_give_is_no_part_of_the_verdict(
    all_installed, monkeypatch, capsys
):
    monkeypatch.setattr(psutil, "cpu_percent", lambda interval: 97.0)
    late = {"failed": doctor._too_slow()}
    monkeypatch.setattr(doctor, "_in_process", lambda *words: late if words == ("env",) else {})
    assert last_line(capsys) == "The default path works."


def test_a_plugin_that_cannot_be_imported_is_in_the_verdict(
    without_processes, all_installed, monkeypatch, capsys
):
    monkeypatch.setitem(doctor.PARTS, "plugins", lambda: {"cannot be imported": "There is no 'my_tsaks'."})
    said = last_line(capsys)
    assert said == "The default path does not work, because of plugins: There is no 'my_tsaks'."


@pytest.mark.parametrize("words", [["speed=false"], ["speed=false", "--json"]])
def test_without_speed_nothing_is_measured_and_every_renderer_is_still_tried(monkeypatch, capsys, words):
    asked = []
    monkeypatch.setattr(doctor, "_in_process", lambda *words: asked.append(words) or {})
    assert cli.main(["doctor", *words]) == 0
    assert "speed" not in capsys.readouterr().out.lower()
    assert {name for name, *_ in asked} == {"torch", "video", "render"}
    assert ("render", "warp", "untimed") in asked and ("render", "gl", "untimed") in asked


@pytest.mark.parametrize(
    ("words", "takes"),
    [
        ([], "This takes about a minute, several on a slow or busy machine"),
        (["speed=false"], "This takes about half a minute"),
    ],
)
def test_it_begins_with_how_long_it_takes(without_processes, capsys, caplog, words, takes):
    with caplog.at_level("INFO", "roboverse_learn.doctor"):
        assert cli.main(["doctor", *words]) == 0
    assert caplog.records[0].getMessage().startswith(takes)
    assert takes not in capsys.readouterr().out


@pytest.mark.slow
def test_a_renderer_is_tried_without_a_measurement():
    assert doctor._in_process("render", "warp", "untimed") == {"renders": "64×64"}
