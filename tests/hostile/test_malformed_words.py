"""Malformed command lines: one message and exit code 2, or accepted; no traceback, nothing written or run.

The words are composed and checked as always; an accepted command ends before its work starts.
"""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from roboverse_learn import cli
from roboverse_learn.config.command_line_keys import flat_keys
from roboverse_learn.config.help import SUMMARIES
from roboverse_learn.config.schema import COMMANDS
from roboverse_learn.config.serialize import default_values

SHORT, WHOLE = 120, 500
"""Command lines in every run of the tests, and with ``-m long``."""

VALUES = (
    *(
        "",
        " ",
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1e400",
        "1e-400",
        "9" * 40,
        "0x10",
        "1_000",
        "true",
        "null",
        "None",
    ),
    *(
        "[]",
        "[[]]",
        "[1",
        "]",
        "{}",
        "{a:1}",
        "{a",
        "[nan]",
        "[null]",
        "['']",
        "'",
        '"',
        "\\",
        "a=b",
        "=",
        "==",
        "~",
        "+",
    ),
    *(
        "<script>alert(1)</script>",
        "../../../etc",
        "..",
        ".",
        "/",
        "/dev/null",
        "/proc/1/mem",
        "~root",
        "$(touch ran)",
    ),
    *(
        "`touch ran`",
        "${oc.env:HOME}",
        "${now:}",
        "!!python/object/apply:os.system ['touch ran']",
        "__import__('os')",
    ),
    *(
        "x" * 300,
        "é",
        "名前",
        "🤖",
        "\u202e",
        "a\nb",
        "a\tb",
        "%s%n",
        "{0}",
        "*",
        "?",
        "act,act",
        "range(-3)",
        "range(1e9)",
    ),
)
NAMES = (
    "",
    "=",
    "_",
    "__class__",
    "env.__init__",
    "a.b.c",
    "policy.",
    ".policy",
    "seed.x",
    "名前",
    "<b>",
    "x" * 300,
    "--",
    "-h=1",
)


def spoiled(number: int) -> list[str]:
    """Returns the malformed command line of a number; the same one every time."""
    rng = random.Random(number)
    command = rng.choice([*SUMMARIES, *COMMANDS])
    known = (
        list(flat_keys(default_values(command, "act")))
        if command in COMMANDS
        else ["dataset", "out", "turns"]
    )
    words = [command]
    for _ in range(rng.randint(1, 3)):
        key = rng.choice(known) if rng.random() < 0.8 else rng.choice(NAMES)
        if rng.random() < 0.1:
            key = key[:-1] + rng.choice("xé_ .")
        words.append(rng.choice(VALUES) if rng.random() < 0.05 else f"{key}={rng.choice(VALUES)}")
    return words


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working directory; commands that would start their work return instead."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "_run", lambda command, config: None)
    monkeypatch.setattr(cli, "_speed", lambda words: 0)
    yield tmp_path


def attempt(words: list[str], capsys: pytest.CaptureFixture[str]) -> str | None:
    """Returns what is wrong with the answer to a command line, or None."""
    try:
        code = cli.main(words)
    except BaseException as error:
        return f"{words}: {type(error).__name__}: {str(error)[:150]}"
    said = capsys.readouterr()
    if code == 0:
        return None
    if code != 2 or "Traceback" in said.err or said.err.count("error: ") != 1:
        return f"{words}: exit code {code}, {said.err[:200]!r}"
    return None


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param(range(SHORT), id="some"),
        pytest.param(range(SHORT, WHOLE), id="rest", marks=pytest.mark.long),
    ],
)
@pytest.mark.slow
def test_malformed_words_get_one_message(
    numbers: range, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = [text for number in numbers if (text := attempt(spoiled(number), capsys))]
    assert not wrong, "\n".join(wrong)
    assert not list(folder.rglob("ran"))
