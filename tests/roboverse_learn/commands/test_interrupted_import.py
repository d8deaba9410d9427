"""An interrupt that a compiled module turns into an ImportError ends a command as any other."""

import signal

import pytest

from envs.core.errors import ConfigError
from roboverse_learn import cli
from roboverse_learn.commands.interrupted_import import interrupts_of_imports
from roboverse_learn.training.interruption import Interrupted


def failed_import(cause: BaseException, *, modules: int = 1) -> ImportError:
    """What pybind11 raises where its module, or one that its module imports, cannot begin."""
    error = ImportError("initialization failed")
    error.__cause__ = cause if modules == 1 else failed_import(cause, modules=modules - 1)
    return error


def ends(error: Exception, monkeypatch: pytest.MonkeyPatch) -> int:
    def run(*_: object) -> int:
        raise error

    monkeypatch.setattr(cli, "_run", run)
    return cli.main(["leaderboard"])


@pytest.mark.parametrize("modules", [1, 2])
@pytest.mark.parametrize(
    ("interrupt", "code"), [(KeyboardInterrupt(), 130), (Interrupted(signal.SIGTERM), 143)]
)
def test_an_import_that_failed_by_an_interrupt_is_the_interrupt(
    interrupt: KeyboardInterrupt,
    code: int,
    modules: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert ends(failed_import(interrupt, modules=modules), monkeypatch) == code
    said = capsys.readouterr().err
    assert said.strip() == "Interrupted. What is saved stays: the same command continues from there."


def test_a_plugin_whose_import_is_interrupted_is_not_said_to_be_broken(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    error = ConfigError("The plugin 'mine' cannot be imported: initialization failed.")
    error.__cause__ = failed_import(KeyboardInterrupt())
    assert ends(error, monkeypatch) == 130
    assert "plugin" not in capsys.readouterr().err


def test_an_import_that_failed_by_itself_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    for error in (ImportError("no such symbol"), failed_import(OSError("no such library"))):
        with pytest.raises(ImportError) as raised:
            ends(error, monkeypatch)
        assert raised.value is error


def test_an_error_of_cleaning_up_after_an_interrupt_is_not_hidden() -> None:
    with pytest.raises(OSError, match="no space"), interrupts_of_imports():
        try:
            raise KeyboardInterrupt
        finally:
            raise OSError("no space")


def test_an_error_that_is_its_own_cause_is_raised() -> None:
    error = ImportError("of itself")
    error.__cause__ = error
    with pytest.raises(ImportError, match="of itself"), interrupts_of_imports():
        raise error
