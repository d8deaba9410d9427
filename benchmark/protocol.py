"""Evaluation protocol: cells, episodes of each, seed.

A protocol is frozen and versioned. Two results are of one protocol when their hashes agree.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from envs.core.errors import ConfigError, unknown_name
from envs.randomization.levels import LEVELS, channels_of
from envs.randomization.splits import SPLITS

if TYPE_CHECKING:
    import numpy as np

VERSION = "v2"
"""The version that this code evaluates: changed whenever an episode of it would change."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One cell of the table of results: a level, or one channel alone, on one split.

    Attributes:
        level: The level, 0 to 3, or None when one channel varies alone.
        only: The channel that varies alone, or several joined by ``+``; None when ``level`` is given.
        split: ``"train"`` or ``"test"``.
    """

    level: int | None = None
    only: str | None = None
    split: str

    def __post_init__(self) -> None:
        if (self.level is None) == (self.only is None):
            raise ConfigError(
                f"A cell has a level or one channel alone; given level={self.level} and only={self.only}."
            )
        if self.level is not None and self.level not in LEVELS:
            raise ConfigError(f"Unknown level {self.level}. Valid: {', '.join(map(str, LEVELS))}.")
        if self.only is not None and channels_of(only=self.only) == ("task",):
            raise ConfigError("The task varies in every cell: name another channel that varies with it.")
        if self.split not in SPLITS:
            raise unknown_name("split", self.split, SPLITS)

    @property
    def condition(self) -> str:
        """Readable name of what varies: ``"level 2"`` or ``"camera alone"``."""
        return f"level {self.level}" if self.only is None else f"{self.only} alone"

    @property
    def name(self) -> str:
        """The cell in the name of a file: ``"level2-test"`` or ``"camera-test"``."""
        return f"level{self.level}-{self.split}" if self.only is None else f"{self.only}-{self.split}"

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
    """

    version: str = VERSION
    levels: tuple[int, ...] = LEVELS
    only: tuple[str, ...] = ()
    splits: tuple[str, ...] = SPLITS
    episodes: int = 100
    seed: int = 0
    width: float | None = None

    def __post_init__(self) -> None:
        if self.version != VERSION:
            raise ConfigError(
                f"Unknown protocol version '{self.version}'. This release evaluates '{VERSION}'; "
                "install the release that wrote the result to run another version."
            )
        for name in ("levels", "only", "splits"):
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

    def cells(self) -> tuple[Cell, ...]:
        """Returns every cell, in the order in which they are evaluated."""
        conditions = [(level, None) for level in self.levels] + [(None, only) for only in self.only]
        return tuple(
            Cell(level=level, only=only, split=split) for level, only in conditions for split in self.splits
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
        """Returns plain JSON values, in the order of the fields; ``width`` only where there is one."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        if self.width is None:
            del values["width"]
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


def canonical_json(values: Any) -> str:
    """Returns the one JSON text of ``values``: sorted keys, no spaces, no NaN."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(values: Any) -> str:
    """Returns the SHA-256 of the canonical JSON, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(values).encode()).hexdigest()


def digest(values: Any) -> str:
    """Returns the first 8 digits of the fingerprint: what names files."""
    return fingerprint(values)[:8]


def _is_count(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least
