"""Docstrings as plain text: what a terminal shows of them."""

import re

_ROLE = re.compile(r":\w+:`~?([^`]+)`")
"""A cross reference, as ``:class:`~envs.spec.EnvSpec```."""


def plain(text: str) -> str:
    """Returns a docstring without the marks of cross references and of code: ``envs.spec.EnvSpec``."""
    return _ROLE.sub(r"\1", text).replace("``", "")
