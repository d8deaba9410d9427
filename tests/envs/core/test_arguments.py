"""``key=value`` words become settings, or a message that says what is valid."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from envs.core.arguments import NoSettings, parse, run_program
from envs.core.errors import ConfigError, UnknownNameError


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What to draw.

    Attributes:
        task: Name of a task.
        draws: How many.
    """

    task: str = "PickCube"
    draws: int = 8
    out: Path | None = None
    redraw: tuple[str, ...] = ()
    record: bool = False


def read(*words):
    return parse("python -m a.b", Settings, words)


def test_values_have_the_kinds_of_the_fields():
    assert read() == Settings()
    words = ("task=StackCube", "draws=3", "out=docs/a.png", "redraw=[A,B]", "record=true")
    expected = Settings(task="StackCube", draws=3, out=Path("docs/a.png"), redraw=("A", "B"), record=True)
    assert read(*words) == expected
    assert read("out=null", "redraw=A,B").redraw == ("A", "B")


def test_an_unknown_key_names_the_nearest():
    with pytest.raises(UnknownNameError, match=r"Unknown key of python -m a.b 'drows'. Did you mean 'draws'"):
        read("drows=3")


@pytest.mark.parametrize("word", ["--task", "PickCube", "draws"])
def test_a_word_without_a_value_lists_the_keys(word):
    with pytest.raises(ConfigError, match=rf"'{word}' is no key=value. Keys of python -m a.b: task, draws"):
        read(word)


def test_a_value_of_another_kind_says_which():
    with pytest.raises(ConfigError, match=r"draws: given 'many'. It is of the type int"):
        read("draws=many")
    with pytest.raises(ConfigError, match=r"The value of 'redraw=\[A' cannot be read"):
        read("redraw=[A")
    with pytest.raises(ConfigError, match="record: given 'perhaps'"):
        read("record=perhaps")


def test_a_path_is_not_empty():
    @dataclass
    class Page:
        out: Path = Path("docs/a.md")

    for word in ("out=", "out=' '"):
        with pytest.raises(ConfigError, match=r"^out= is empty, and names a file or folder: give one"):
            parse("python -m a.b", Page, [word])


def test_a_mistake_ends_a_program_with_one_line(capsys):
    assert run_program("python -m a.b", Settings, lambda given: given.draws, ["draws=5"]) == 5
    assert run_program("python -m a.b", Settings, lambda given: given.draws, ["drows=5"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: Unknown key of python -m a.b 'drows'.") and said.count("\n") == 1


def test_a_program_without_settings_takes_no_words(capsys):
    assert run_program("python -m a.b", NoSettings, lambda _: 0, []) == 0
    assert run_program("python -m a.b", NoSettings, lambda _: 0, ["a=1"]) == 2
    assert capsys.readouterr().err == "error: python -m a.b takes no words, given 'a=1'.\n"


def test_help_is_the_docstring(capsys):
    with pytest.raises(SystemExit, match="0"):
        read("--help")
    said = capsys.readouterr().out
    assert said.startswith("python -m a.b key=value") and "draws: How many." in said


def test_help_has_no_marks_of_cross_references_and_of_code(capsys):
    @dataclass(frozen=True)
    class Marked:
        """Draws by :class:`~envs.spec.EnvSpec`, see :mod:`envs.spec`.

        Attributes:
            draws: ``1`` or more.
        """

        draws: int = 1

    with pytest.raises(SystemExit, match="0"):
        parse("python -m a.b", Marked, ["--help"])
    said = capsys.readouterr().out
    assert "Draws by envs.spec.EnvSpec, see envs.spec." in said and "draws: 1 or more." in said
