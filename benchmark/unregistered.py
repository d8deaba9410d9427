"""Results of channels and levels that are not registered here: whole files, which a board leaves out."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError, UnknownNameError, UnregisteredError
from envs.randomization.channels import CHANNELS
from envs.randomization.levels import NAMED_LEVELS, channels_of

_PLUGINS = re.compile(r"plugins=\[?[\w.]+(, ?[\w.]+)*\]?")


def check_registered(path: Path, document: Mapping[str, Any]) -> None:
    """Checks that every channel and level that a file's protocol names is registered here.

    Args:
        path: The file.
        document: What it holds: its ``protocol``, and the ``command`` that wrote it, if it has one.

    Raises:
        UnregisteredError: One is not, and the message names it and the plugins that the command had; or it
            cannot be imported.
    """
    for only in document["protocol"].get("only", ()):
        try:
            channels_of(only=only)
        except UnknownNameError as error:
            known = {"task", *CHANNELS, *NAMED_LEVELS}
            unknown = [name for name in str(only).split("+") if name not in known] or [only]
            raise UnregisteredError(
                f"Results file '{path}' names the channel or level '{'+'.join(unknown)}', which is not "
                f"registered here. Add {_plugins_of(document)}, or install the package that has it."
            ) from error
        except ConfigError as error:  # a level of a package that cannot be imported, or of two packages
            raise UnregisteredError(f"Results file '{path}': {error}") from error


def _plugins_of(document: Mapping[str, Any]) -> str:
    """Returns the word of the command that imported plugins, or its form."""
    try:
        words = shlex.split(str(document.get("command", "")))
    except ValueError:
        words = []
    return next((word for word in words if _PLUGINS.fullmatch(word)), "plugins=[<module>]")
