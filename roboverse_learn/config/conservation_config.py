"""Configuration of ``roboverse conservation``."""

from dataclasses import dataclass

from envs.core.ranges import check_ranges


@dataclass(frozen=True, kw_only=True, slots=True)
class ConservationConfig:
    """``roboverse conservation``: tests conservation of momentum and energy on each simulator.

    Attributes:
        simulators: Registered simulators, as in simulators=[mujoco]; empty takes all that are installed.
        timestep_s: Time step of physics.
        out: Folder of the results, plots and the page.
    """

    simulators: tuple[str, ...] = ()
    timestep_s: float = 0.005
    out: str = "conservation"

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("timestep_s",))
