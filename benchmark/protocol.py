"""Evaluation protocol: cells, episodes of each, seed.

A protocol is frozen and versioned. Two results are of one protocol when their hashes agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError, unknown_name
from envs.core.fingerprint import fingerprint
from envs.randomization.levels import LEVELS, channels_of
from envs.randomization.splits import SPLIT_NAMES, SPLITS
from policies.base import listed

if TYPE_CHECKING:
    import numpy as np

INSTRUCTION_TESTS = ("known", "new_frame", "new_words", "wrong", "empty", "switched")
"""What the instruction of an episode at level 0 may be instead of the task's own words:

- ``known``: a wording of the train split;
- ``new_frame`` and ``new_words``: a held-out wording of either kind;
- ``wrong``: that of another task;
- ``empty``: nothing;
- ``switched``: right at first, and that of another task from the middle of the episode on.

Success is always that of the task itself. A policy that reads keeps it under the first three and loses it
under the others.
"""

NOT_ASKED = ("wrong", "empty", "switched")
"""Tests in which a policy that reads its instruction does not do the task."""

KNOWN, HELD_OUT = "known", ("new_frame", "new_words")
"""The test of known wordings, and those of held-out ones, which are compared with it."""

VERSION = "v2"
"""The version that this code evaluates: changed whenever an episode of it would change."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One cell of the table of results: a level, one channel alone, or an instruction test, on one split.

    Attributes:
        level: The level, 0 to 3, or None when one channel varies alone.
        only: The channel that varies alone, or several joined by ``+``; None when ``level`` is given.
        split: One of :data:`~envs.randomization.splits.SPLIT_NAMES`.
        instruction_test: One of :data:`INSTRUCTION_TESTS`, at level 0; None leaves the instruction.
    """

    level: int | None = None
    only: str | None = None
    split: str
    instruction_test: str | None = None

    def __post_init__(self) -> None:
        if (self.level is None) == (self.only is None):
            raise ConfigError(
                f"A cell has a level or one channel alone; given level={self.level} and only={self.only}."
            )
        if self.level is not None and self.level not in LEVELS:
            raise ConfigError(f"Unknown level {self.level}. Valid: {', '.join(map(str, LEVELS))}.")
        if self.only is not None and channels_of(only=self.only) == ("task",):
            raise ConfigError("The task varies in every cell: name another channel that varies with it.")
        if self.split not in SPLIT_NAMES:
            raise unknown_name("split", self.split, SPLIT_NAMES)
        if self.instruction_test is not None:
            check_instruction_test(self.instruction_test)
            if self.level != 0:
                raise ConfigError(f"Instructions are tested at level 0; given level={self.level}.")

    @property
    def condition(self) -> str:
        """Readable name of what varies: ``"level 2"``, ``"camera alone"``, ``"instruction wrong"``."""
        if self.instruction_test is not None:
            return f"instruction {self.instruction_test.replace('_', ' ')}"
        return f"level {self.level}" if self.only is None else f"{self.only} alone"

    @property
    def name(self) -> str:
        """The cell in a file's name: ``"level2-test"``, ``"camera-test"``, ``"instruction_wrong-test"``."""
        if self.instruction_test is not None:
            return f"instruction_{self.instruction_test}-{self.split}"
        return f"level{self.level}-{self.split}" if self.only is None else f"{self.only}-{self.split}"

    @property
    def right(self) -> "Cell":
        """The cell with the task's own instruction, whose episodes begin as this one's."""
        return self.tested_as(None)

    def tested_as(self, instruction_test: str | None) -> "Cell":
        """Returns the cell of another instruction test, whose episodes begin as this one's."""
        return replace(self, instruction_test=instruction_test)

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values; without the instruction test where there is none."""
        own = {"level": self.level, "only": self.only, "split": self.split}
        return own if self.instruction_test is None else own | {"instruction_test": self.instruction_test}

    def __str__(self) -> str:
        return f"{self.condition}, {self.split} split"


@dataclass(frozen=True, kw_only=True, slots=True)
class Protocol:
    """Episodes that a policy is evaluated on; the task decides when one ends.

    Attributes:
        version: Version of the protocol; the first folder under ``results/``.
        levels: Levels, each evaluated on every split.
        only: Channels that are also evaluated alone, to measure the cost of each.
        splits: Splits. The headline is the test split.
        episodes: Episodes per cell: the first of the frozen split.
        seed: Root of the episodes' randomness, of the scene's and of the policy's.
        width: A cell ends once the interval of its success rate is this narrow, and ``episodes`` is the
            most; None evaluates all of them. The interval stays valid: see
            :func:`benchmark.statistics.confidence_sequence`.
        instructions: Some of :data:`INSTRUCTION_TESTS`, each evaluated on the episodes of level 0.
    """

    version: str = VERSION
    levels: tuple[int, ...] = LEVELS
    only: tuple[str, ...] = ()
    splits: tuple[str, ...] = SPLITS
    episodes: int = 100
    seed: int = 0
    width: float | None = None
    instructions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.version != VERSION:
            raise ConfigError(
                f"Unknown protocol version '{self.version}'. This release evaluates '{VERSION}'; "
                "install the release that wrote the result to run another version."
            )
        for name in ("levels", "only", "splits", "instructions"):
            values = getattr(self, name)
            if len(set(values)) != len(values):
                raise ConfigError(f"The protocol's {name} must differ from each other, given {list(values)}.")
        if not self.cells():
            raise ConfigError(
                f"The protocol has no cells: levels={list(self.levels)}, only={list(self.only)}, "
                f"splits={list(self.splits)}. Give at least one level or channel, and one split."
            )
        if not _is_count(self.episodes, 1):
            raise ConfigError(f"episodes must be a whole number of at least 1, given {self.episodes!r}.")
        if not _is_count(self.seed, 0):
            raise ConfigError(f"seed must be a whole number of at least 0, given {self.seed!r}.")
        if self.width is not None and not 0.0 < self.width < 1.0:
            raise ConfigError(
                f"width must be between 0 and 1, given {self.width!r}: 0.1 ends a cell when its interval "
                "spans 10 points."
            )
        check_instruction_tests(self.instructions, self.levels, self.width)

    def cells(self) -> tuple[Cell, ...]:
        """Returns every cell, in the order in which they are evaluated."""
        conditions: list[tuple[int | None, str | None, str | None]] = [
            *((level, None, None) for level in self.levels),
            *((None, only, None) for only in self.only),
            *((0, None, test) for test in self.instructions),
        ]
        return tuple(
            Cell(level=level, only=only, split=split, instruction_test=test)
            for level, only, test in conditions
            for split in self.splits
        )

    def episodes_of(self, split_indices: "Sequence[int] | np.ndarray") -> list[int]:
        """Returns the episodes of one cell, the first of its split.

        Args:
            split_indices: Every episode of the split, in frozen order.

        Raises:
            ConfigError: The split has fewer episodes than the protocol.
        """
        return episodes(split_indices, self.episodes)

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values, in the order of the fields; the last two only where they are given."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        if self.width is None:
            del values["width"]
        if not self.instructions:
            del values["instructions"]
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Protocol":
        """Builds a protocol from what :meth:`to_json` returned.

        Raises:
            ConfigError: A value is not valid.
        """
        arguments: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**arguments)

    @property
    def hash(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of the canonical JSON."""
        return fingerprint(self.to_json())[:16]


def episodes(split_indices: "Sequence[int] | np.ndarray", num_episodes: int) -> list[int]:
    """Returns the first ``num_episodes`` of a split.

    Raises:
        ConfigError: The split is smaller than that.
    """
    if num_episodes > len(split_indices):
        raise ConfigError(
            f"{num_episodes} episodes were requested and the split has {len(split_indices)}. "
            f"Set episodes to at most {len(split_indices)}."
        )
    return [int(index) for index in split_indices[:num_episodes]]


def check_instruction_test(name: str) -> None:
    """Checks that an instruction test exists.

    Raises:
        UnknownNameError: It does not.
    """
    if name not in INSTRUCTION_TESTS:
        raise unknown_name("instruction test", name, INSTRUCTION_TESTS)


def check_instruction_tests(names: Sequence[str], levels: Sequence[int], width: float | None) -> None:
    """Checks that instructions can be tested beside these levels.

    Raises:
        UnknownNameError: A test does not exist.
        ConfigError: Level 0 is absent, or cells end when their interval is narrow.
    """
    for name in names:
        check_instruction_test(name)
    if names and 0 not in levels:
        raise ConfigError(
            f"instructions={listed(names)} are compared with the right instruction, which is level 0; add "
            f"it: levels={listed(map(str, (0, *levels)))}."
        )
    if names and width is not None:
        raise ConfigError(
            f"instructions={listed(names)} are compared episode by episode, and width={width} ends each cell "
            "after another number of them. Leave one out."
        )


def _is_count(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least
