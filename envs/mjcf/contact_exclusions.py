"""Finds pairs of bodies of one tree that never collide, so that collision tests can skip them.

The bounding volumes of neighbouring links overlap, so MuJoCo tests their meshes in every step. Of the Panda
these are the base and the first link, 1 mm apart, and four pairs around the elbow; one mesh has 6,260
vertices.
"""

import itertools

import mujoco
import numpy as np

from envs.mjcf.collision import touching

MAX_JOINTS = 2
"""Joints between two bodies up to which all their postures are tried."""

_POSTURES = 25
"""Tried positions of each joint."""

_BEYOND_RAD = 0.05
"""Limits give way by less than this much, rad or m."""

_LEAST_GAP_M = 5e-4


def pairs_never_in_contact(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Returns the names of pairs of bodies that MuJoCo tests and that never touch.

    Postures are tried on a grid over the ranges of the joints between two bodies; pairs with more joints
    between them, or with a ball joint, are left alone.

    Args:
        model: The compiled scene; not written to.
    """
    data, found = mujoco.MjData(model), []
    for (one, other), pairs in _tested(model).items():
        joints = _joints_between(model, one, other)
        if joints is None or not 1 <= len(joints) <= MAX_JOINTS:
            continue
        if _stay_apart(model, data, pairs, joints):
            found.append((model.body(one).name, model.body(other).name))
    return found


def _tested(model: mujoco.MjModel) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Returns pairs of bodies to the pairs of their geoms that MuJoCo tests; the world is left out."""
    geoms = np.flatnonzero((model.geom_contype | model.geom_conaffinity) * model.geom_bodyid)
    tested: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for one, other in geoms[np.argwhere(np.triu(touching(model, geoms)))].tolist():
        bodies = int(model.geom_bodyid[one]), int(model.geom_bodyid[other])
        tested.setdefault(bodies, []).append((one, other))
    return tested


def _joints_between(model: mujoco.MjModel, one: int, other: int) -> list[int] | None:
    """Returns the joints that two bodies of one tree do not share, or None if they cannot be tried."""
    chains = [_chain(model, body) for body in (one, other)]
    if chains[0][-1] != chains[1][-1]:
        return None
    joints = []
    for body in set(chains[0]) ^ set(chains[1]):
        first = int(model.body_jntadr[body])
        joints += range(first, first + int(model.body_jntnum[body]))
    turning = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return joints if all(model.jnt_type[joint] in turning for joint in joints) else None


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """Returns a body and all that carry it, but for the world."""
    chain = []
    while body:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def _stay_apart(
    model: mujoco.MjModel, data: mujoco.MjData, pairs: list[tuple[int, int]], joints: list[int]
) -> bool:
    data.qpos[:] = model.qpos0
    for posture in itertools.product(*(_positions(model, joint) for joint in joints)):
        data.qpos[model.jnt_qposadr[joints]] = posture
        mujoco.mj_kinematics(model, data)
        for pair in pairs:
            if mujoco.mj_geomDistance(model, data, *pair, 10 * _LEAST_GAP_M, None) < _LEAST_GAP_M:
                return False
    return True


def _positions(model: mujoco.MjModel, joint: int) -> np.ndarray:
    if not model.jnt_limited[joint]:
        reach = np.pi if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE) else 10.0
        return np.linspace(-reach, reach, _POSTURES)
    low, high = model.jnt_range[joint]
    return np.linspace(low - _BEYOND_RAD, high + _BEYOND_RAD, _POSTURES)
