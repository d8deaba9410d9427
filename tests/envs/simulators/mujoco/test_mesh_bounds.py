"""Bounds of meshes: they hold every vertex, are never wider than the tracer's, and change no image."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from envs.simulators.mujoco.mesh_bounds import MeshBounds
from envs.spec import EnvSpec

MODEL = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.1 0  0 0 0.05  0.2 0.02 0.04"/>
    <mesh name="rod" vertex="-1 -.01 -.01  1 -.01 -.01  -1 .01 -.01  1 .01 .01  -1 -.01 .01  1 0 .02"/>
  </asset>
  <worldbody>
    <geom name="ball" type="sphere" size="0.1"/>
    <body mocap="true"><geom type="mesh" mesh="wedge"/></body>
    <geom type="box" size="0.1 0.1 0.1"/>
    <body mocap="true"><geom type="mesh" mesh="rod"/></body>
  </worldbody>
</mujoco>
"""

WEDGE, ROD = 2, 3
"""Geoms of the meshes: those of the world come first."""

ROWS = {ROD: 0, WEDGE: 3}
"""Their rows in the context."""


class Array(np.ndarray):
    """An array that is read as Warp's are."""

    def numpy(self):
        return self


def scene():
    """The model, its data, a context of its geoms in another order, and the bounds of its meshes."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    context = SimpleNamespace(
        enabled_geom_ids=np.array([ROD, 0, 1, WEDGE]).view(Array),
        lower=np.full((4, 3), 7.0, np.float32).view(Array),
        upper=np.full((4, 3), 9.0, np.float32).view(Array),
    )
    return model, mujoco.MjData(model), context, MeshBounds(model, context)


def corners(model, data, geom):
    """The vertices of a geom's mesh in the world."""
    mesh = model.geom_dataid[geom]
    start = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
    return vertices, vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


def moved(model, data, rng):
    data.mocap_pos[:], data.mocap_quat[:] = rng.normal(size=(2, 3)), rng.normal(size=(2, 4))
    data.mocap_quat[:] /= np.linalg.norm(data.mocap_quat, axis=1, keepdims=True)
    mujoco.mj_kinematics(model, data)


def test_they_hold_every_vertex_and_are_no_wider_than_the_tracers():
    model, data, context, bounds = scene()
    rng = np.random.default_rng(0)
    for _ in range(200):
        moved(model, data, rng)
        bounds.write(data)
        for geom, row in ROWS.items():
            vertices, points = corners(model, data, geom)
            half = np.abs(data.geom_xmat[geom].reshape(3, 3)) @ np.abs(vertices).max(axis=0)
            lower, upper = context.lower[row], context.upper[row]
            assert (lower < points.min(axis=0)).all() and (upper > points.max(axis=0)).all()
            assert (lower > data.geom_xpos[geom] - half - 1e-4).all()
            assert (upper < data.geom_xpos[geom] + half + 1e-4).all()


def test_those_of_a_mesh_are_exact_whenever_it_rests():
    model, data, context, bounds = scene()
    rng = np.random.default_rng(1)
    moved(model, data, rng)
    bounds.write(data)
    loose = np.array(context.upper)
    data.mocap_pos[1] += 0.5  # the rod moves, the wedge rests
    mujoco.mj_kinematics(model, data)
    for _ in range(2):
        bounds.write(data)
        points = corners(model, data, WEDGE)[1]
        np.testing.assert_allclose(context.lower[ROWS[WEDGE]], points.min(axis=0), atol=1e-4)
        np.testing.assert_allclose(context.upper[ROWS[WEDGE]], points.max(axis=0), atol=1e-4)
    assert (loose[ROWS[WEDGE]] - context.upper[ROWS[WEDGE]]).max() > 1e-3
    points = corners(model, data, ROD)[1]
    np.testing.assert_allclose(context.upper[ROWS[ROD]], points.max(axis=0), atol=1e-4)
    moved(model, data, rng)
    bounds.write(data)
    for geom, row in ROWS.items():
        points = corners(model, data, geom)[1]
        assert (context.lower[row] < points.min(axis=0)).all()
        assert (context.upper[row] > points.max(axis=0)).all()
    bounds.write(data)
    for geom, row in ROWS.items():
        np.testing.assert_allclose(context.upper[row], corners(model, data, geom)[1].max(axis=0), atol=1e-4)


def test_geoms_that_are_no_meshes_keep_theirs():
    model, data, context, bounds = scene()
    moved(model, data, np.random.default_rng(2))
    bounds.write(data)
    assert (context.lower[[1, 2]] == 7.0).all() and (context.upper[[1, 2]] == 9.0).all()


@pytest.mark.slow
def test_images_are_the_same_without_them(monkeypatch):
    env = EnvSpec(task="PickCube", level=3, image_size=48).make(1, num_threads=1)
    only, rng = np.array([0]), np.random.default_rng(3)

    def image():
        return np.array(env.observe(only)["observation.images.front"][0])

    try:
        for episode in env.split_indices[:2]:
            env.reset_envs(only, np.array([episode]))
            for _ in range(3):
                tight = [image(), image()]
                with monkeypatch.context() as patched:
                    patched.setattr(MeshBounds, "write", lambda self, data: None)
                    assert all((image() == one).all() for one in tight)
                env.step_envs(only, rng.uniform(env.controller.low, env.controller.high)[None])
    finally:
        env.close()
