"""Collision pairs and convex hulls of a compiled model, for simulators that build their scene from it."""

import mujoco
import numpy as np


def hull_of(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Returns the vertices of the convex hull of a geom's mesh, (V, 3); MuJoCo has found them already."""
    mesh = int(model.geom_dataid[geom])
    first = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    graph = model.mesh_graphadr[mesh]
    if graph < 0:
        return vertices
    count = model.mesh_graph[graph]
    return vertices[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]


def touching(model: mujoco.MjModel, geoms: np.ndarray) -> np.ndarray:
    """Returns which geoms touch which, (G, G) bool, by MuJoCo's rules for bits, parents, pairs, exclusions.

    Args:
        model: The compiled scene.
        geoms: Ids, (G,).
    """
    kind, with_kind = model.geom_contype[geoms], model.geom_conaffinity[geoms]
    body = model.geom_bodyid[geoms]
    weld = model.body_weldid[body]
    parent = model.body_weldid[model.body_parentid[weld]]
    touch = ((kind[:, None] & with_kind) | (with_kind[:, None] & kind)) != 0
    touch &= weld[:, None] != weld
    jointed = (parent[:, None] == weld) | (weld[:, None] == parent)
    touch &= ~(jointed & (weld[:, None] != 0) & (weld != 0))
    excluded = np.isin((body[:, None] << 16) + body, model.exclude_signature)
    touch &= ~(excluded | excluded.T)
    where = {int(geom): index for index, geom in enumerate(geoms)}
    for one, other in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
        if one in where and other in where:
            touch[where[one], where[other]] = touch[where[other], where[one]] = True
    return touch
