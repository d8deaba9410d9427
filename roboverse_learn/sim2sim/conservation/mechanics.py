"""Momentum, angular momentum and kinetic energy of objects, from their description and states.

Textbook rigid-body mechanics (Goldstein, "Classical Mechanics", chapter 5): each geom contributes p = m v,
L = c × m v + I ω and E = m v²/2 + ω·I ω/2, with its own centre of mass c. No simulator is involved: equal
states give equal numbers.

Shape legend: T = samples in time.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from envs.core.errors import ConfigError
from envs.rotations import multiply, rotate, to_matrix
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg
from envs.state import EntityState


class Motion(NamedTuple):
    """Pose and velocity of a frame.

    Attributes:
        pos: Position of its origin, (T, 3), m.
        rot: Orientation, (T, 4), wxyz.
        lin_vel: Velocity of its origin, (T, 3), m/s.
        ang_vel: Angular velocity in the world frame, (T, 3), rad/s.
    """

    pos: np.ndarray
    rot: np.ndarray
    lin_vel: np.ndarray
    ang_vel: np.ndarray

    def at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns position and velocity, each (T, 3), of a point (3,) of the frame."""
        arm = rotate(self.rot, np.broadcast_to(point, self.pos.shape))
        return self.pos + arm, self.lin_vel + np.cross(self.ang_vel, arm)


class Conserved(NamedTuple):
    """Quantities that an isolated system conserves.

    Attributes:
        momentum: (T, 3), kg·m/s.
        angular_momentum: About a fixed point, (T, 3), kg·m²/s.
        kinetic_energy: (T,), J.
    """

    momentum: np.ndarray
    angular_momentum: np.ndarray
    kinetic_energy: np.ndarray


def conserved(
    objects: Sequence[ObjectCfg], states: Mapping[str, EntityState], about: Sequence[float]
) -> Conserved:
    """Sums the conserved quantities of free objects.

    Args:
        objects: Objects of boxes and spheres.
        states: Object's name to its T states.
        about: Reference point of angular momentum, m.

    Raises:
        ConfigError: if a geom with a mass is no box and no sphere.
    """
    parts = []
    for item in objects:
        for motion, geom in _moving_geoms(item, states[item.name]):
            centre, velocity = motion.at(np.asarray(geom.pos, np.float64))
            turn = to_matrix(multiply(motion.rot, np.broadcast_to(geom.rot, motion.rot.shape)))
            inertia = np.einsum("tij,j,tkj->tik", turn, principal_inertia(geom), turn)
            spin = np.einsum("tij,tj->ti", inertia, motion.ang_vel)
            momentum = geom.mass_kg * velocity
            energy = 0.5 * np.sum(momentum * velocity + spin * motion.ang_vel, axis=1)
            parts.append((momentum, np.cross(centre - np.asarray(about), momentum) + spin, energy))
    return Conserved(*(np.sum(values, axis=0) for values in zip(*parts, strict=True)))


def principal_inertia(geom: GeomCfg) -> np.ndarray:
    """Returns the moments of inertia about a geom's own axes, (3,), kg·m²."""
    if geom.shape == "sphere":
        return np.full(3, 0.4 * geom.mass_kg * geom.size[0] ** 2)
    if geom.shape == "box":
        squares = np.square(geom.size)  # of half sizes
        return geom.mass_kg / 3.0 * (squares.sum() - squares)
    raise ConfigError(f"The inertia of a {geom.shape} is not known here; take a box or a sphere.")


def _moving_geoms(item: ObjectCfg, state: EntityState) -> list[tuple[Motion, GeomCfg]]:
    values = (state.pos, state.rot, state.lin_vel, state.ang_vel, state.joint_pos, state.joint_vel)
    pos, rot, lin_vel, ang_vel, joint_pos, joint_vel = (v.double().cpu().numpy() for v in values)
    frames: dict[str | None, Motion] = {None: Motion(pos, rot, lin_vel, rotate(rot, ang_vel))}
    found = [(frames[None], geom) for geom in item.geoms]
    joint = 0
    for link in item.links:
        columns = (joint_pos[:, joint], joint_vel[:, joint]) if link.joint is not None else None
        joint += link.joint is not None
        frames[link.name] = _moved(frames[link.parent], link, columns)
        found += [(frames[link.name], geom) for geom in link.geoms]
    return [(motion, geom) for motion, geom in found if geom.mass_kg > 0.0]


def _moved(parent: Motion, link: LinkCfg, joint: tuple[np.ndarray, np.ndarray] | None) -> Motion:
    """Returns the motion of a link from that of its parent and its joint's position and speed, each (T,)."""
    rot = multiply(parent.rot, np.broadcast_to(link.rot, parent.rot.shape))
    if link.joint is None or joint is None:
        pos, velocity = parent.at(np.asarray(link.pos))
        return Motion(pos, rot, velocity, parent.ang_vel)
    angle, speed = joint
    axis = rotate(rot, np.broadcast_to(np.asarray(link.joint.axis, np.float64), parent.pos.shape))
    if link.joint.kind == "slide":
        pos, velocity = parent.at(np.asarray(link.pos))
        pos = pos + axis * angle[:, None]
        way = np.cross(parent.ang_vel, axis * angle[:, None])
        return Motion(pos, rot, velocity + way + axis * speed[:, None], parent.ang_vel)
    anchor = np.broadcast_to(np.asarray(link.joint.pos, np.float64), parent.pos.shape)
    start = rotate(np.asarray(link.rot, np.float64), np.asarray(link.joint.pos, np.float64))
    place, velocity = parent.at(np.asarray(link.pos) + start)
    half = 0.5 * angle[:, None]
    own = np.concatenate([np.cos(half), np.sin(half) * np.asarray(link.joint.axis, np.float64)], axis=1)
    turned = multiply(rot, own)
    ang_vel = parent.ang_vel + axis * speed[:, None]
    arm = -rotate(turned, anchor)
    return Motion(place + arm, turned, velocity + np.cross(ang_vel, arm), ang_vel)
