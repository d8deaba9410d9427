"""Odd places to start a command from: one clear message or the usual output, never a traceback."""

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from envs.core.assets import ASSETS, asset_folder, cache_dir
from envs.core.errors import ConfigError, MissingAssetError
from roboverse_learn import cli

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


def in_shell(script: str, folder: Path, **environment: str) -> "subprocess.CompletedProcess[str]":
    """Runs a script of bash in a folder, in which ``$R`` starts our program."""
    program = shlex.join([sys.executable, "-m", "roboverse_learn"])
    added = {"R": program, "PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env=os.environ | added,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize(
    "words",
    ["train policy=act task=PickCube preset=quick", "evaluate checkpoint=x", "new task Foo", "assets list"],
)
def test_a_working_folder_that_was_removed_is_named(words: str, tmp_path: Path) -> None:
    done = in_shell(f"mkdir gone && cd gone && rmdir ../gone && $R {words}", tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.endswith("was removed or moved. Change to one that exists, as by: cd ~\n"), done.stderr
    assert done.stderr.count("error: ") == 1 and "Traceback" not in done.stderr


def test_lists_and_help_need_no_working_folder(tmp_path: Path) -> None:
    script = "mkdir gone && cd gone && rmdir ../gone && $R list policies && $R train --help"
    done = in_shell(script, tmp_path)
    assert done.returncode == 0 and "Policies:" in done.stdout


@pytest.mark.parametrize(
    ("script", "environment", "said"),
    [
        (
            "$R collect num_demos=1 dataset=ü",
            {"LC_ALL": "C", "PYTHONUTF8": "0"},
            "'dataset=??' is no text in this terminal's encoding, ascii. Set LC_ALL=C.UTF-8",
        ),
        (
            "$R collect num_demos=1 dataset=$'\\xfc'",
            {"PYTHONUTF8": "1"},
            "'dataset=?' is no text in this terminal's encoding, utf-8. Rename it in UTF-8.",
        ),
    ],
    ids=["plain-locale", "bytes-of-latin-1"],
)
def test_a_path_that_is_no_text_here_is_named(
    script: str, environment: dict[str, str], said: str, tmp_path: Path
) -> None:
    done = in_shell(script, tmp_path, **environment)
    assert done.returncode == 2 and f"error: {said}" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", ["train --help", "list", "--help", "speed --help"])
def test_a_terminal_without_unicode_shows_the_rest(words: str, tmp_path: Path) -> None:
    done = in_shell(f"$R {words}", tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "") and len(done.stdout) > 200


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&-", "| true", ">/dev/full"])
def test_streams_that_are_closed_or_full_leave_no_traceback(closed: str, tmp_path: Path) -> None:
    done = in_shell(f"$R list {closed}; exit ${{PIPESTATUS[0]}}", tmp_path)
    assert done.returncode == (2 if closed == ">/dev/full" else 0)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("closed", "code", "message"), [("| true", 0, ""), (">/dev/full", 2, "error: No space")]
)
def test_short_output_that_cannot_be_written_ends_like_long_output(
    closed: str, code: int, message: str, tmp_path: Path
) -> None:
    done = in_shell(
        f"env -u PYTHONUNBUFFERED $R --version {closed}; exit ${{PIPESTATUS[0]}}", tmp_path
    )  # buffered, as at a user's, it is written as the program ends
    assert done.returncode == code
    assert done.stderr.startswith(message) and "Exception ignored" not in done.stderr


@pytest.mark.parametrize("value", ["1", "2"])
def test_optimized_python_refuses_the_same_words(value: str, tmp_path: Path) -> None:
    script = "$R train policy=atc; $R train train.lr=nan; $R collect num_demos=0; $R check robot=x"
    done = in_shell(script, tmp_path, PYTHONOPTIMIZE=value)
    plain = in_shell(script, tmp_path)
    assert done.stderr == plain.stderr and done.stderr.count("error: ") == 4


def test_a_cache_that_cannot_be_made_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "file"))
    with pytest.raises(
        ConfigError, match=r"cannot be made: Not a directory\. Set ROBOVERSE_CACHE to a folder"
    ):
        cache_dir("models")


def test_a_look_at_assets_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOVERSE_DATA", raising=False)
    with pytest.raises(MissingAssetError):
        asset_folder(next(iter(ASSETS)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("variable", ["ROBOVERSE_CACHE", "XDG_CACHE_HOME"])
def test_an_empty_variable_of_the_cache_is_as_if_unset(
    variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROBOVERSE_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv(variable, "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_dir("models") == tmp_path / ".cache/roboverse/models"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", "task="], "check needs task=<name> or robot=<name>"),
        (["convert", "notes.txt", "--to", "mjcf"], "'notes.txt' is no file of a robot by its name"),
        (["help", "trian"], "Unknown command 'trian'. Did you mean 'train'?"),
        (["train", "seed=-1", "preset=quick"], "seed must be 0 or more, given -1."),
        (
            ["train", "batch_size=100000000000"],
            "batch_size must be at most 1,048,576, given 100,000,000,000.",
        ),
        (["train", "train.num_threads=100000"], "train.num_threads must be at most 1,024, given 100,000."),
        (["speed", "throughput", "turns=-1"], "turns must be above 0, given -1."),
        (["speed", "throughput", "turns=0"], "turns must be above 0, given 0."),
        (["speed", "training", "steps=-1"], "steps must be 0 or more, given -1."),
        (["speed", "teleoperation", "seconds=nan"], "seconds must be above 0, given nan."),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_more_mistakes_get_one_message(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("no robot")
    assert cli.main(words) == 2
    shown = capfd.readouterr().err
    assert said in shown and shown.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("first", ["help", "-h", "--help"])
def test_help_before_a_command_is_that_of_the_command(first: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([first, "train", "policy=diffusion"]) == 0
    assert "policy.down_dims=[256,512,1024]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("program", "ends"),
    [("bin/roboverse", (-2, "")), ("-m", (0, "")), ("notebook", (0, ""))],
    ids=["command", "other-module", "library"],
)
def test_ctrl_c_while_libraries_are_imported_ends_a_command_in_silence(
    program: str, ends: tuple[int, str], tmp_path: Path
) -> None:
    code = (
        f"import os, signal, sys; sys.argv = [{program!r}]; import roboverse_learn\n"
        "try: os.kill(os.getpid(), signal.SIGINT); signal.pause()\n"
        "except KeyboardInterrupt: pass"
    )
    words = [sys.executable, "-c", code]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == ends


def test_a_command_that_has_begun_says_how_it_goes_on_after_ctrl_c() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)  # as while libraries are imported
    try:
        assert cli.main(["--version"]) == 0
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 36 bytes."),
        RuntimeError("CUDA out of memory. Tried to allocate 20.00 MiB."),
    ],
    ids=["numpy", "cpu", "gpu"],
)
def test_too_little_memory_is_no_bug(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(cli, "_run", fail)
    assert cli.main(["leaderboard"]) == 2
    assert "There is not enough memory. Take a smaller train.batch_size" in capsys.readouterr().err


def test_another_runtime_error_is_a_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("shapes do not fit")

    monkeypatch.setattr(cli, "_run", fail)
    with pytest.raises(RuntimeError, match="shapes do not fit"):
        cli.main(["leaderboard"])
