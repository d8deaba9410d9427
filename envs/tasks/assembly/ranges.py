"""Start ranges by name, as MimicGen's D0, D1 and D2."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, override

import numpy as np

from envs.core.errors import ConfigError, unknown_name
from envs.tasks.arm_at_table import Start, check_option
from envs.tasks.robosuite.scene import RobosuiteTask

_TRIES = 10_000


@dataclass(frozen=True, slots=True)
class Range:
    """Where one object may start.

    Attributes:
        x_m: Range along x.
        y_m: Likewise along y.
        yaw_rad: Range of its turn.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    yaw_rad: tuple[float, float] = (0.0, 0.0)


Ranges = Mapping[str, Mapping[str, Range]]
"""Name of a range to objects' names to their ranges."""


@dataclass(frozen=True, kw_only=True)
class RangedTask(RobosuiteTask):
    """A task at robosuite's table with several start ranges.

    Attributes:
        start_range: Which: ``D0`` is the narrowest.
    """

    ranges: ClassVar[Ranges]
    radii_m: ClassVar[Mapping[str, float]]
    """Radius round each object within which no other one starts."""

    joints: ClassVar[Mapping[str, tuple[float, ...]]] = {}
    """Joint positions of articulated objects at the start."""

    start_range: str = "D0"

    @override
    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name != "start_range":
                check_option(f"task_kwargs.{item.name}", getattr(self, item.name), item.default)
        if self.start_range not in self.ranges:
            raise unknown_name(f"start_range of {self.name}", str(self.start_range), self.ranges)

    def heights_m(self) -> Mapping[str, float]:
        """Returns the height of each object's origin at the start, m."""
        return {item.name: item.pos[2] for item in self.objects}

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        ranges, heights = self.ranges[self.start_range], self.heights_m()
        for _ in range(_TRIES):
            drawn = {
                name: (rng.uniform(*one.x_m), rng.uniform(*one.y_m), rng.uniform(*one.yaw_rad))
                for name, one in ranges.items()
            }
            if self._apart(drawn):
                return {
                    name: Start((x, y, heights[name]), yaw, self.joints.get(name, ()))
                    for name, (x, y, yaw) in drawn.items()
                }
        raise ConfigError(f"The objects of {self.name} find no room in start_range={self.start_range}.")

    def _apart(self, drawn: Mapping[str, tuple[float, float, float]]) -> bool:
        names = list(drawn)
        return all(
            np.hypot(drawn[a][0] - drawn[b][0], drawn[a][1] - drawn[b][1]) > self.radii_m[a] + self.radii_m[b]
            for index, a in enumerate(names)
            for b in names[:index]
        )
