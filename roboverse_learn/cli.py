"""The command line: ``roboverse <command> key=value ...``.

It parses arguments, calls a command, prints its result, and turns errors into one message and an exit
code: 0 done, 1 a bug (with its traceback), a contract that ``check`` found broken or a video that ``dataset
info`` found damaged, 2 a mistake that the user can fix, 130 interrupted by Ctrl-C, 143 by SIGTERM.
"""

import errno
import importlib
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from io import TextIOWrapper
from typing import Any

from envs.core.atomic import file_for_folder, folder_for_file
from envs.core.errors import ConfigError, RoboVerseError, unknown_name
from envs.core.registry import PLUGINS_VARIABLE, leave_out_broken_plugins, load_plugins
from roboverse_learn.commands.called_with import called_with
from roboverse_learn.commands.child_process import end_with_parent
from roboverse_learn.commands.interrupted_import import interrupts_of_imports
from roboverse_learn.commands.sigterm import sigterm_interrupts
from roboverse_learn.config import help as help_texts
from roboverse_learn.config.command_line_keys import plugin_names
from roboverse_learn.config.compose import compose
from roboverse_learn.config.preflight import check_folders, check_working_folder
from roboverse_learn.training.interruption import Interrupted

HELP = ("-h", "--help", "help")

# A full disk, a spent quota, a limit on the size of files, a folder that may not be written.
_MENDABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)

_OUT_OF_MEMORY = ("can't allocate memory", "out of memory")
"""Of PyTorch's messages on a CPU and on a GPU."""

_START_AGAIN = ("check", "conservation", "convert", "doctor", "list", "new", "speed", "view")
"""Commands that keep nothing of what an interruption cuts off."""

_CONTINUES = " What is saved stays: the same command continues from there."

_SAYS_WHAT_IS = ("doctor", "list", "--version")
"""Words that are answered without plugins that cannot be imported, as each command's help is."""

_OF_WORDS = ("assets", "dataset")
"""Commands whose function takes the words themselves."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: The words after the program's name; those of this process when None.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    end_with_parent()
    _write_any_character()
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # all of this is imported
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with sigterm_interrupts(), called_with(words), interrupts_of_imports():
            code = _dispatch(words)
        _flush_output()
        return code
    except RoboVerseError as error:
        return _fail(str(error))
    except KeyboardInterrupt as interrupt:
        saved = "" if words[:1] and words[0] in _START_AGAIN else _CONTINUES
        print(f"\nInterrupted.{saved}", file=sys.stderr)
        return interrupt.exit_code if isinstance(interrupt, Interrupted) else 130
    except (MemoryError, RuntimeError) as error:
        return _fail(_not_enough_memory(error))
    except BrokenPipeError:  # the reader of our output went away, as in `roboverse list | head -1`
        _discard_output()
        return 0
    except OSError as error:
        with suppress(OSError):  # else Python tries again as it ends, with a message and a code of its own
            _flush_output()
        return _fail(_system_error(error))


def _system_error(error: OSError) -> str:
    """Returns the message of a system error that the user can mend; raises any other."""
    if wrong := folder_for_file(error) or file_for_folder(error):
        return wrong
    if error.errno not in _MENDABLE:
        raise error
    return (
        f"{error.strerror}: {error.filename or 'a file could not be written'}. "
        "Free some space or choose another folder, and run the same command again: it continues."
    )


def _flush_output() -> None:
    """Writes what is still buffered; what cannot be written is discarded.

    Raises:
        OSError: It cannot be written.
    """
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        _discard_output()
        raise


def _discard_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _not_enough_memory(error: MemoryError | RuntimeError) -> str:
    """Returns the message of an error that memory ran out; raises any other."""
    if isinstance(error, RuntimeError) and not any(words in str(error) for words in _OUT_OF_MEMORY):
        raise error
    return (
        "There is not enough memory. Take a smaller train.batch_size, image_size or num_envs, or end other "
        "programs, and run the same command again."
    )


def _write_any_character() -> None:
    """Writes a question mark for a character that the terminal's or the log's encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def script(command: str) -> None:
    """Runs ``command`` with the words of this process and ends the process: the body of our scripts."""
    sys.exit(main([command, *sys.argv[1:]]))


def _check_text(words: Sequence[str]) -> None:
    """Checks that every word is text, as libraries that take a path require.

    Raises:
        ConfigError: One holds bytes that the encoding of this process does not have.
    """
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as error:
            encoding = sys.getfilesystemencoding()
            way_out = (
                "Rename it in UTF-8."
                if encoding == "utf-8"
                else "Set LC_ALL=C.UTF-8 and PYTHONUTF8=1, or choose a name in plain letters."
            )
            raise ConfigError(
                f"'{word.encode(errors='replace').decode()}' is no text in this terminal's encoding, "
                f"{encoding}. {way_out}"
            ) from error


def _dispatch(words: list[str]) -> int:
    _check_text(words)
    _check_named_plugins(words)
    if len(words) > 1 and words[0] in HELP:  # as in `roboverse help train`
        words = [*words[1:], HELP[0]]
    if not words or words[0] in HELP:
        print(help_texts.overview())
        return 0
    if words == ["--version"]:
        print(f"roboverse {version('roboverse-learn')}")
        return 0
    command, rest = words[0], _without_plugins(words[1:])
    if command == "benchmark":  # the former name of speed, until the next release
        command = "speed"
    if command not in help_texts.SUMMARIES:
        raise unknown_name("command", command, help_texts.SUMMARIES, "Start with: roboverse --help")
    if command == "speed":
        return _speed(rest)
    asks = rest[:1] if command == "dataset" else rest  # its actions have help of their own
    if any(word in HELP for word in asks) or (command in ("dataset", "sweep") and not rest):
        chosen = [word.removeprefix("policy=") for word in rest if word.startswith("policy=")]
        print(help_texts.command_help(command, (chosen or ["act"])[-1]))
        return 0
    if command == "list":
        print(help_texts.list_command(rest))
        return 0
    check_working_folder()
    if command in _OF_WORDS:
        _start_logging()
        report = _function(command)(rest)
        print(report)
        return _code(report)
    config = _read(command, rest)
    _start_logging()
    return _run(command, config) or 0


def _check_named_plugins(words: list[str]) -> None:
    """Imports the plugins of the environment variable; what says what there is goes on without a broken one.

    Raises:
        ConfigError: Another command is given, and one of them cannot be imported.
    """
    broken = leave_out_broken_plugins().values()
    if words and words[0] not in _SAYS_WHAT_IS and not any(word in HELP for word in words):
        if broken:
            raise ConfigError("\n".join(broken))
    elif words[:1] != ["doctor"]:  # it lists them
        for each in broken:
            print(f"warning: {each}", file=sys.stderr)


def _without_plugins(words: list[str]) -> list[str]:
    """Imports the modules of ``plugins=[...]``, here and in processes started later; returns the other words.

    Raises:
        ConfigError: One of them cannot be imported.
    """
    others = [word for word in words if not word.startswith("plugins=")]
    if len(others) < len(words):
        before = f"plugins={os.environ.get(PLUGINS_VARIABLE, '')}"
        os.environ[PLUGINS_VARIABLE] = ",".join(plugin_names([before, *words]))
        load_plugins()
    return others


def _named(words: list[str], *keys: str) -> list[str]:
    """Takes ``task LiftBlock`` for ``kind=task name=LiftBlock``: the first words without a key have these."""
    left = list(keys)
    return [word if "=" in word or not left else f"{left.pop(0)}={word}" for word in words]


def _settings(words: list[str]) -> list[str]:
    """Takes ``robot.urdf --to mjcf`` for ``robot=robot.urdf to=mjcf``, as converters are called elsewhere."""
    settings: list[str] = []
    for word in words:
        if settings and settings[-1].endswith("=") and "=" not in word:
            settings[-1] += word
        elif word.startswith("--"):
            name = word.removeprefix("--")
            settings.append(name if "=" in name else f"{name}=")
        else:
            settings.append(word if "=" in word else f"robot={word}")
    return settings


def _read(command: str, words: list[str]) -> Any:
    """Returns what the words after a command mean."""
    if command == "sweep":
        from roboverse_learn.sweep import plan

        return plan(words)
    if command == "convert":
        words = _settings(words)
    if command == "new":
        words = _named(words, "kind", "name")
    if command == "check":
        words = _named(words, "task")
    if command == "doctor":
        words = ["json=true" if word == "--json" else word for word in words]
    config = compose(command, words)
    check_folders(config)
    return config


def _run(command: str, config: Any) -> int:
    """Calls a command and prints what it returns; returns the exit code."""
    report = _function(command)(config)
    _show(report)
    if warning := getattr(report, "warning", ""):
        _flush_output()  # the report comes before the warning
        print(f"warning: {warning}", file=sys.stderr)
    if failure := getattr(report, "failure", ""):
        _flush_output()  # the report comes before the error
        return _fail(failure)
    return _code(report)


def _code(report: Any) -> int:
    """Returns the exit code: 1 where what a command returned says that not all is ``ok``."""
    return 0 if getattr(report, "ok", True) else 1


def _function(command: str) -> Callable[[Any], Any]:
    """Returns the function of a command, from the module of its name; heavy imports begin here."""
    module = importlib.import_module(f"roboverse_learn.{command}")
    return module.convert_robot if command == "convert" else getattr(module, command)


def _speed(words: list[str]) -> int:
    from roboverse_learn.speed import PROGRAMS, run

    names = [word for word in words if "=" not in word and word not in HELP]
    settings = [word for word in words if "=" in word]
    if len(names) == 1 and len(words) > 1 and words[-1] in HELP:
        return run(names[0], ["--help"])
    if any(word in HELP for word in words):
        rows = "\n".join(f"  {name:<12} {PROGRAMS.entry(name).summary}" for name in PROGRAMS)
        print(
            "Usage: roboverse speed [name ...]\n       roboverse speed name key=value ...\n\n"
            f"{rows}\n\nroboverse speed name --help lists its settings."
        )
        return 0
    for name in names:
        PROGRAMS.entry(name)  # every name is checked before the first one runs
    if settings and len(names) != 1:
        raise ConfigError(
            f"'{settings[0]}' is a setting of one program, given {len(names)} names. Valid: "
            f"{', '.join(PROGRAMS.names())}."
        )
    return max(run(name, settings) for name in names or PROGRAMS.names())


def _show(report: Any) -> None:
    """Prints what a command returned."""
    if isinstance(report, str):  # a path that is to be copied is not broken into lines
        print(report)
        return
    from rich.console import Console

    console = Console() if sys.stdout.isatty() else Console(width=120)
    console.print(
        report, crop=False
    )  # a path may be wider than the terminal, which then goes on in the next line


def _start_logging() -> None:
    """Shows what our own packages log; other libraries speak from a warning on."""
    logging.basicConfig(format="%(message)s", level=logging.WARNING, stream=sys.stderr)
    for handler in logging.getLogger().handlers:
        handler.setLevel(logging.INFO)  # lines of progress are for a run's log where the terminal has a bar
    for package in ("envs", "policies", "benchmark", "roboverse_learn"):
        logging.getLogger(package).setLevel(logging.INFO)
    logging.getLogger("roboverse_learn.progress").setLevel(logging.DEBUG)


def _fail(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
