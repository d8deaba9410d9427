"""Three scenes without gravity that test conservation laws on a simulator.

- ``collision``: a ball hits another one off its centre, with friction. Momentum and angular momentum are
  conserved; kinetic energy may only be lost.
- ``spin``: a box turns about its middle axis of inertia, which is unstable (the Dzhanibekov effect). All
  three are conserved.
- ``chain``: three links on two hinges without damping move freely. All three are conserved.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, PhysicsCfg, ScenarioCfg
from envs.simulators import HANDLERS
from envs.state import EntityState, State
from roboverse_learn.sim2sim.conservation.mechanics import Conserved, conserved

MIDDLE = (0.0, 0.0, 2.0)
"""Centre of every scene, far above the ground, m."""

SAMPLES = 200
"""Samples of the state in each experiment."""

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Experiment:
    """One scene and its initial state.

    Attributes:
        name: Its name.
        objects: Its objects.
        start: Initial state: object to ``pos``, ``rot``, ``lin_vel`` (world), ``ang_vel`` (body),
            ``joint_pos``, ``joint_vel``.
        duration_s: Simulated time.
        keeps_energy: Whether kinetic energy is conserved; a contact may lose some.
    """

    name: str
    objects: tuple[ObjectCfg, ...]
    start: Mapping[str, Mapping[str, tuple[float, ...]]]
    duration_s: float
    keeps_energy: bool = True


def _ball(name: str, mass_kg: float) -> ObjectCfg:
    geom = GeomCfg(shape="sphere", size=(0.1,), mass_kg=mass_kg, friction=(0.5, 0.005, 0.0001))
    return ObjectCfg(name=name, geoms=(geom,))


COLLISION = Experiment(
    name="collision",
    objects=(_ball("moving", 1.0), _ball("resting", 2.0)),
    start={
        "moving": {"pos": (-0.5, -0.04, 2.0), "lin_vel": (1.0, 0.0, 0.0)},
        "resting": {"pos": (0.0, 0.04, 2.0)},
    },
    duration_s=1.5,
    keeps_energy=False,
)

SPIN = Experiment(
    name="spin",
    objects=(ObjectCfg(name="brick", geoms=(GeomCfg(shape="box", size=(0.3, 0.15, 0.05), mass_kg=2.0),)),),
    start={"brick": {"pos": MIDDLE, "lin_vel": (0.1, 0.0, 0.0), "ang_vel": (0.02, 3.0, 0.02)}},
    duration_s=8.0,
)

_LINK = GeomCfg(shape="box", size=(0.2, 0.04, 0.04), pos=(0.2, 0.0, 0.0), mass_kg=0.5, collides=False)


def _link(name: str, parent: str | None, x: float, axis: tuple[float, float, float]) -> LinkCfg:
    hinge = ObjectJointCfg(kind="hinge", axis=axis, range=(-100.0, 100.0))
    return LinkCfg(name=name, geoms=(_LINK,), joint=hinge, parent=parent, pos=(x, 0.0, 0.0))


CHAIN = Experiment(
    name="chain",
    objects=(
        ObjectCfg(
            name="chain",
            geoms=(GeomCfg(shape="box", size=(0.2, 0.06, 0.06), mass_kg=1.0, collides=False),),
            links=(
                _link("first", None, 0.2, (0.0, 0.0, 1.0)),
                _link("second", "first", 0.4, (0.0, 1.0, 0.0)),
            ),
        ),
    ),
    start={
        "chain": {
            "pos": MIDDLE,
            "lin_vel": (0.2, -0.1, 0.0),
            "ang_vel": (0.3, 0.2, 0.5),
            "joint_pos": (0.4, -0.6),
            "joint_vel": (1.5, -1.0),
        }
    },
    duration_s=5.0,
)

EXPERIMENTS = (COLLISION, SPIN, CHAIN)


def scene(experiment: Experiment, timestep_s: float) -> ScenarioCfg:
    """Returns the scene of an experiment: no robot, no table, no walls, no gravity."""
    physics = PhysicsCfg(timestep_s=timestep_s, gravity=(0.0, 0.0, 0.0))
    return ScenarioCfg(objects=experiment.objects, table=None, room=None, physics=physics)


def start_of(experiment: Experiment) -> State:
    """Returns the initial state of an experiment, one row."""
    objects = {}
    for item in experiment.objects:
        given = experiment.start[item.name]
        joints = np.array([given.get("joint_pos", ())], np.float64)
        rest = EntityState.at_rest(np.array([given["pos"]]), np.array([given.get("rot", UPRIGHT)]), joints)
        for field in ("lin_vel", "ang_vel", "joint_vel"):
            if field in given:
                setattr(rest, field, torch.tensor([given[field]], dtype=torch.float64))
        objects[item.name] = rest
    return State({}, objects)


def run(experiment: Experiment, simulator: str, timestep_s: float) -> tuple[np.ndarray, Conserved]:
    """Runs an experiment.

    Returns:
        Time of each sample, (T,), s, and the conserved quantities.

    Raises:
        RoboVerseError: The simulator does not support this scene, or fails.
    """
    steps = max(1, round(experiment.duration_s / timestep_s / SAMPLES))
    with HANDLERS.get(simulator)(scene(experiment, timestep_s), 1) as handler:
        handler.launch()
        handler.set_states(start_of(experiment).to(handler.device, handler.dtype))
        states = [handler.get_states().to("cpu")]
        for _ in range(round(experiment.duration_s / timestep_s / steps)):
            handler.step(steps)
            states.append(handler.get_states().to("cpu"))
    flats = [state.flatten() for state in states]
    whole = State.unflatten({key: torch.cat([flat[key] for flat in flats]) for key in flats[0]})
    seconds = timestep_s * steps * np.arange(len(states))
    return seconds, conserved(experiment.objects, whole.objects, MIDDLE)


def deviations(found: Conserved) -> dict[str, np.ndarray]:
    """Returns the deviation of each quantity from its first value, relative to it, (T,) each.

    That of kinetic energy is signed: positive where energy is gained.
    """
    out: dict[str, Any] = {}
    for name in ("momentum", "angular_momentum"):
        values = getattr(found, name)
        out[name] = np.linalg.norm(values - values[0], axis=1) / np.linalg.norm(values[0])
    out["kinetic_energy"] = found.kinetic_energy / found.kinetic_energy[0] - 1.0
    return out
