"""Settings of Bullet's solver in a scenario: the block ``simulators["pybullet"]``."""

from dataclasses import dataclass

from envs.core.errors import ConfigError
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "pybullet"


@dataclass(frozen=True, kw_only=True, slots=True)
class PybulletSettings(SimulatorSettings):
    """Options of the solver; see the PyBullet Quickstart Guide, ``setPhysicsEngineParameter``.

    Attributes:
        iterations: Iterations of the constraint solver.
        erp: Share of a contact's penetration that one step mends.
        contact_margin_m: Distance below which two things are looked at for contact.
    """

    simulator = SIMULATOR

    iterations: int = 100
    erp: float = 0.2
    contact_margin_m: float = 0.02

    def __post_init__(self) -> None:
        if self.iterations < 1 or not 0 < self.erp <= 1 or self.contact_margin_m <= 0:
            raise ConfigError(f"{SIMULATOR} needs iterations ≥ 1, 0 < erp ≤ 1, contact_margin_m > 0: {self}.")
