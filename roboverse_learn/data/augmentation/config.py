"""Settings of ``source=augment``; light to import, for the command line's schema reads it."""

from dataclasses import dataclass
from typing import Literal, get_args

from envs.core.errors import ConfigError, unknown_name
from envs.core.ranges import check_ranges

Choose = Literal["nearest", "random"]


@dataclass(frozen=True, kw_only=True, slots=True)
class AugmentConfig:
    """How demonstrations are made from others.

    Attributes:
        choose: Source of each piece: nearest, one of the ``augment.nearest`` most like now, or random.
        nearest: Number of nearest sources among which one is drawn.
        num_sources: Source demonstrations, from the first on; 0 takes all of the dataset.
        bridge_speed_m_s: Fastest that the hand moves to the beginning of a piece.
        noise_m: Standard deviation of how far the hand first misses, and then corrects; 3 times as much in 3
            of 10 ways.
        refine_grasp: Plan again when the gripper begins to close, from where the object then is.
        retries: How often an episode begins a subtask again that it failed.
        least_steps: Shortest movement of an object that counts, in control steps.
    """

    choose: Choose = "nearest"
    nearest: int = 3
    num_sources: int = 0
    bridge_speed_m_s: float = 0.8
    noise_m: float = 0.01
    refine_grasp: bool = True
    retries: int = 2
    least_steps: int = 4

    def __post_init__(self) -> None:
        if self.choose not in get_args(Choose):
            raise unknown_name("value of augment.choose", str(self.choose), get_args(Choose))
        check_ranges(self, "augment.", from_0=("num_sources", "retries"), from_1=("nearest", "least_steps"))
        if not 0.0 < self.bridge_speed_m_s <= 2.0:
            raise ConfigError(
                f"augment.bridge_speed_m_s must be above 0 and at most 2, given {self.bridge_speed_m_s}."
            )
        if not 0.0 <= self.noise_m <= 0.05:
            raise ConfigError(f"augment.noise_m must be 0 to 0.05, given {self.noise_m}.")
