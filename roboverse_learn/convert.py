"""``roboverse convert``: a robot in another format."""

from pathlib import Path
from typing import Any

from roboverse_learn.config import ConvertConfig


def convert_robot(config: ConvertConfig) -> Any:
    """Converts a robot; returns what to print: the file that was written.

    Raises:
        UnknownNameError: There is no such robot, format or body.
        ConfigError: The source is no single robot, the format cannot hold it, or the folder is in use.
        MissingExtraError: A package that the format needs is not installed.
    """
    from rich.console import Group
    from rich.text import Text

    from envs.convert import convert

    path = convert(
        config.robot,
        config.to,
        root=config.root or None,
        simplify=config.simplify,
        out=Path(config.out) if config.out else None,
    )
    return Group(Text(str(path), no_wrap=True, overflow="ignore"))  # one line, however long
