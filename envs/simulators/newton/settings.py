"""Settings of Newton's solver in a scenario: the block ``simulators["newton"]``."""

from dataclasses import dataclass

from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.settings import CONES, INTEGRATORS
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "newton"


@dataclass(frozen=True, kw_only=True, slots=True)
class NewtonSettings(SimulatorSettings):
    """Options of Newton's ``SolverMuJoCo``: a scenario's block ``simulators["newton"]``.

    Attributes:
        integrator: ``euler``, ``implicit``, ``implicitfast`` or ``rk4``.
        cone: ``elliptic`` or ``pyramidal`` friction cones.
        impratio: Ratio of frictional to normal constraint impedance.
        iterations: Largest number of the solver's iterations.
        tolerance: Improvement of the cost at which it stops.
    """

    simulator = SIMULATOR

    integrator: str = "implicitfast"
    cone: str = "elliptic"
    impratio: float = 10.0
    iterations: int = 100
    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        for name, valid in (("integrator", INTEGRATORS), ("cone", CONES)):
            if getattr(self, name) not in valid:
                raise unknown_name(f"{name} of {SIMULATOR}", str(getattr(self, name)), valid)
        if self.iterations < 1:
            raise ConfigError(f"iterations of {SIMULATOR} must be at least 1, given {self.iterations}.")
