"""Settings of PhysX in a scenario: the block ``simulators["sapien"]``."""

from dataclasses import dataclass

from envs.core.errors import ConfigError
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "sapien"


@dataclass(frozen=True, kw_only=True, slots=True)
class SapienSettings(SimulatorSettings):
    """Options of PhysX: a scenario's block ``simulators["sapien"]``.

    Attributes:
        position_iterations: Of the solver; 15 is ManiSkill's.
        velocity_iterations: Of the solver; 1 is ManiSkill's.
        contact_offset_m: Distance at which contacts begin to be looked for.
        bounce_threshold: Speed, m/s, below which nothing bounces.
    """

    simulator = SIMULATOR

    position_iterations: int = 15
    velocity_iterations: int = 1
    contact_offset_m: float = 0.01
    bounce_threshold: float = 2.0

    def __post_init__(self) -> None:
        for name in ("position_iterations", "velocity_iterations"):
            if not 0 < getattr(self, name) < 256:
                raise ConfigError(f"{name} of {SIMULATOR} is 1 to 255, given {getattr(self, name)}.")
