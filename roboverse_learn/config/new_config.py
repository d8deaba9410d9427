"""Configuration of ``roboverse new``."""

import keyword
import re
from dataclasses import dataclass

from envs.core.errors import ConfigError, unknown_name

NEW_KINDS = ("task", "policy", "robot")
"""What a skeleton can be made of."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_EXAMPLES = {"task": "LiftBlock", "policy": "my_cnn", "robot": "my_arm"}


@dataclass(frozen=True, kw_only=True, slots=True)
class NewConfig:
    """``roboverse new task name=LiftBlock``: a package with a working task, policy or robot to start from.

    Attributes:
        kind: What is made: task, policy or robot; typed as the first word alone.
        name: Name by which commands will know it: letters, digits and underscores.
        out: Folder to write, which must not exist; empty for one named after the package.
    """

    kind: str = "task"
    name: str = ""
    out: str = ""

    def __post_init__(self) -> None:
        if self.kind not in NEW_KINDS:
            hint = "As in: roboverse new task name=LiftBlock"
            raise unknown_name("kind of skeleton", self.kind, NEW_KINDS, hint)
        example = f"as in: roboverse new {self.kind} name={_EXAMPLES[self.kind]}"
        if not self.name:
            raise ConfigError(f"new {self.kind} needs name=<name>, {example}")
        if not _NAME.fullmatch(self.name):
            raise ConfigError(
                f"name={self.name} is no name of letters, digits and underscores that begins with a letter, "
                f"{example}"
            )
        if keyword.iskeyword(self.module) or keyword.iskeyword(self.class_name):
            raise ConfigError(f"name={self.name} is a word of Python. Choose another one, {example}")

    @property
    def module(self) -> str:
        """Name of the package: ``lift_block`` for ``LiftBlock``."""
        parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", self.name)
        return re.sub(r"_+", "_", parts).strip("_").lower()

    @property
    def class_name(self) -> str:
        """Name of its class: ``LiftBlock`` for ``lift_block``."""
        return "".join(part[:1].upper() + part[1:] for part in self.name.split("_"))

    @property
    def folder(self) -> str:
        """The folder that is written."""
        return self.out or self.module
