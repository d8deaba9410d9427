"""Every command that a page shows takes the keys that it is shown with, and its tasks have its cameras."""

import importlib
import re
import shlex
from collections.abc import Iterator
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

from envs.core import arguments
from envs.core.errors import MissingExtraError, RoboVerseError
from envs.lerobot.env import RoboVerseEnvConfig
from envs.lerobot.robot import RoboVerseRobotConfig
from roboverse_learn.config.help import SUMMARIES
from roboverse_learn.data.check_program import run_check
from tests.understood import understand

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *sorted(path for path in DOCS.rglob("*.md") if not {"site", ".cache"} & {*path.parts}),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
]
IS_OF_A_READER = re.compile(
    r"(?<!^checkpoint)(?<!^from)=(…|<[\w ]+>$)|plugins=|=LiftBlock|my_|short|=arm|=mlp|=folder$|=\w+\|"
)
"""Words that stand for something of a reader's own."""


def shown(page: Path, program: str) -> Iterator[list[str]]:
    """Yields the words of every command of a page that begins with a program, without a reader's own."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    for line in re.findall(rf"(?:^|`){program}([a-z][^`\n#]*)", text, re.MULTILINE):
        words = shlex.split(line.rstrip(") "))
        yield [word for word in words if not IS_OF_A_READER.search(word)]


def pages_with(program: str) -> list[Path]:
    return [page for page in PAGES if any(shown(page, program))]


def ids(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_with("roboverse "), ids=ids)
def test_commands_take_their_keys_and_tasks_have_their_cameras(page: Path) -> None:
    wrong = []
    for name, *words in shown(page, "roboverse "):
        settings = [word for word in words if "=" in word]
        try:
            assert name in SUMMARIES, f"there is no command '{name}'"
            understand(name, settings)
        except MissingExtraError:
            continue  # of a task whose assets are optional
        except (AssertionError, RoboVerseError) as error:
            wrong.append(f"{name} {' '.join(settings)}: {error}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_commands_on_a_package_that_is_not_installed_name_it_as_a_plugin(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    commands = re.findall(r"^roboverse [^\n]*|(?<=`)roboverse [^`]*", text, re.MULTILINE)
    of_a_package = re.compile(r" (?:task=LiftBlock|policy=my_cnn|robot=(?:my_)?arm)(?=\s|$)")
    named = re.compile(r"\splugins=\[")
    assert not [each for each in commands if of_a_package.search(each) and not named.search(each)]


class ParsedError(Exception):
    """The words of a program were understood, and it does not run."""


def read_words(module: ModuleType, words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """Returns the exit code of a program that only reads its words."""

    def parse(command: str, kind: type, given: list[str]) -> None:
        arguments.parse(command, kind, given)
        raise ParsedError

    reads_only = {
        "run_program": lambda command, kind, _, given=None: arguments.run_program(
            command, kind, lambda _: 0, given
        ),
        "run_check": lambda argv, source, defaults, _: run_check(argv, source, defaults, lambda *_: None),
        "parse": parse,
    }
    program = next(name for name in reads_only if hasattr(module, name))
    monkeypatch.setattr(module, program, reads_only[program])
    try:
        return module.main(words)
    except ParsedError:
        return 0


@pytest.mark.parametrize("page", pages_with("python -m "), ids=ids)
def test_modules_are_there_and_take_their_keys(
    page: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, *words in shown(page, "python -m "):
        if name == "pytest":
            assert all((ROOT / word).exists() for word in words if word.startswith("tests"))
            continue
        assert find_spec(name), f"there is no module '{name}'"
        if settings := [word for word in words if "=" in word]:
            code = read_words(importlib.import_module(name), settings, monkeypatch)
            assert code == 0, f"{name} {settings}: {capsys.readouterr()}"


@pytest.mark.parametrize("page", pages_with("lerobot-"), ids=ids)
def test_lerobots_commands_take_the_keys_of_our_plugins(page: Path) -> None:
    kinds = {"env": RoboVerseEnvConfig, "robot": RoboVerseRobotConfig}
    for words in shown(page, "lerobot-"):
        for section, kind in kinds.items():
            if f"--{section}.type=roboverse" in words:
                keys = [word.partition("=")[0] for word in words if word.startswith(f"--{section}.")]
                wrong = {key.partition(".")[2] for key in keys} - {
                    "type",
                    *(each.name for each in fields(kind)),
                }
                assert not wrong, f"--{section}.type=roboverse takes no {wrong}: {words}"
