"""``roboverse convert``: a robot in another format."""

from pathlib import Path

from roboverse_learn.config.other_commands import ConvertConfig


def convert_robot(config: ConvertConfig) -> str:
    """Converts a robot; returns what to print: the file that was written.

    Raises:
        UnknownNameError: There is no such robot, format or body.
        ConfigError: The source is no single robot, the format cannot hold it, or the folder is in use.
        MissingExtraError: A package that the format needs is not installed.
    """
    from envs.convert import convert

    path = convert(
        config.robot,
        config.to,
        root=config.root or None,
        simplify=config.simplify,
        packages=Path(config.packages) if config.packages else None,
        out=Path(config.out) if config.out else None,
    )
    return str(path)
