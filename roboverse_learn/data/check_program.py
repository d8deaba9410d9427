"""What programs share that measure a source of demonstrations: their words, messages and exit codes."""

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from envs.core.errors import ConfigError, RoboVerseError
from roboverse_learn.config.compose import compose

logger = logging.getLogger(__name__)


def run_check(
    argv: Sequence[str] | None,
    source: str,
    defaults: Mapping[str, str],
    measure: Callable[[Any, int, Mapping[str, str]], None],
) -> int:
    """Measures a source and logs what is found; returns the exit code.

    Args:
        argv: Words of the command line, those of ``roboverse collect`` too; None takes those of this process.
        source: Registered source of ``roboverse collect``.
        defaults: Keys of the program itself, ``episodes`` among them, and their values.
        measure: Takes the configuration of the collection, the number of episodes and the program's own keys.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        is_own = [word.partition("=")[0] in defaults for word in words]
        given = [word.split("=", 1) for word, mine in zip(words, is_own, strict=True) if mine]
        own = {**defaults, **dict(given)}
        rest = [word for word, mine in zip(words, is_own, strict=True) if not mine]
        config = compose("collect", [f"source={source}", *rest])
        count = own["episodes"]
        if not count.isdecimal() or not int(count):
            raise ConfigError(f"episodes must be a number above 0, given {count}.")
        measure(config, int(count), own)
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    return 0
