"""Settings of Genesis's rigid solver in a scenario: the block ``simulators["genesis"]``."""

from dataclasses import dataclass

from envs.core.errors import ConfigError, unknown_name
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "genesis"

CONES = ("elliptic", "pyramidal")
INTEGRATORS = {"euler": "Euler", "implicitfast": "implicitfast"}
"""Ours to the names of ``genesis.integrator``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GenesisSettings(SimulatorSettings):
    """Options of Genesis's ``RigidOptions``: a scenario's block ``simulators["genesis"]``.

    Attributes:
        integrator: ``euler`` or ``implicitfast``.
        cone: ``elliptic`` or ``pyramidal`` friction cones.
        impratio: Ratio of frictional to normal constraint impedance.
        iterations: Largest number of the solver's iterations.
        tolerance: Improvement of the cost at which it stops.
        max_pairs: Largest number of pairs of shapes that are looked at for contact in one environment.
    """

    simulator = SIMULATOR

    integrator: str = "implicitfast"
    cone: str = "elliptic"
    impratio: float = 10.0
    iterations: int = 100
    tolerance: float = 1e-8
    max_pairs: int = 150

    def __post_init__(self) -> None:
        for name, valid in (("integrator", tuple(INTEGRATORS)), ("cone", CONES)):
            if getattr(self, name) not in valid:
                raise unknown_name(f"{name} of {SIMULATOR}", str(getattr(self, name)), valid)
        for name in ("iterations", "max_pairs"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} of {SIMULATOR} must be at least 1, given {getattr(self, name)}.")
