"""Options of MuJoCo's solver, which are part of the compiled model: a scenario's ``simulators["mujoco"]``."""

from dataclasses import dataclass

import mujoco

from envs.core.errors import unknown_name
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "mujoco"

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}

JACOBIANS = {
    "auto": mujoco.mjtJacobian.mjJAC_AUTO,
    "dense": mujoco.mjtJacobian.mjJAC_DENSE,
    "sparse": mujoco.mjtJacobian.mjJAC_SPARSE,
}


@dataclass(frozen=True, kw_only=True, slots=True)
class MujocoSettings(SimulatorSettings):
    """Options of the solver; see MuJoCo's documentation, "XML reference: option".

    Attributes:
        integrator: ``euler``, ``implicit``, ``implicitfast`` or ``rk4``.
        cone: ``elliptic`` or ``pyramidal`` friction cones.
        impratio: Ratio of frictional to normal constraint impedance. Elliptic cones with impratio 10
            keep a grasped object from creeping out of the fingers ("Modeling: slip").
        jacobian: ``auto``, ``dense`` or ``sparse``.
        iterations: Largest number of the solver's iterations.
        tolerance: Improvement of the cost at which it stops.
        density: Density of the air, kg/m³, whose drag acts on every body's inertia box; 0 is none.
        viscosity: Viscosity of the air, Pa·s.
    """

    simulator = SIMULATOR

    integrator: str = "implicitfast"
    cone: str = "elliptic"
    impratio: float = 10.0
    jacobian: str = "auto"
    iterations: int = 100
    tolerance: float = 1e-8
    density: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        for name, valid in (("integrator", INTEGRATORS), ("cone", CONES), ("jacobian", JACOBIANS)):
            if getattr(self, name) not in valid:
                raise unknown_name(f"{name} of {SIMULATOR}", str(getattr(self, name)), valid)

    def write(self, option: mujoco.MjOption) -> None:
        """Writes them into a model's options."""
        option.integrator = INTEGRATORS[self.integrator]
        option.cone = CONES[self.cone]
        option.jacobian = JACOBIANS[self.jacobian]
        option.impratio = self.impratio
        option.iterations = self.iterations
        option.tolerance = self.tolerance
        option.density = self.density
        option.viscosity = self.viscosity
