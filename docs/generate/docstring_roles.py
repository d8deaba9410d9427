"""Turns Sphinx roles of docstrings into code: ``:class:`~envs.spec.EnvSpec``` is ``EnvSpec``.

An extension of Griffe, which reads the sources for mkdocstrings; ``docs/mkdocs.yml`` names it.
"""

import re
from typing import Any

import griffe

ROLE = re.compile(r":\w+:`(~?)([^`]+)`")


def plain(text: str) -> str:
    """Returns a docstring with code spans in place of roles; after ``~`` only the last part is kept."""
    return ROLE.sub(lambda role: f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`", text)


class DocstringRoles(griffe.Extension):
    """See the module."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rewrites the docstring of one object."""
        del kwargs
        if obj.docstring is not None:
            obj.docstring.value = plain(obj.docstring.value)
