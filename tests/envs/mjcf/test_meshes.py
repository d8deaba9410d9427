"""Visual meshes: merged by colour, simplified, cached; collision meshes are left alone."""

import logging

import fast_simplification
import mujoco
import numpy as np
import pytest
import trimesh

from envs.mjcf.meshes import VISUAL_GROUP, simplify_visuals
from envs.mjcf.model import build_model
from envs.tasks.pick_cube import PickCube

ARM = """
<mujoco>
  <asset>
    <mesh name="ball" file="ball.obj" scale="0.1 0.1 0.1"/>
    <mesh name="shell" file="ball.obj" scale="0.2 0.2 0.2"/>
    <mesh name="label" file="ball.obj" scale="0.01 0.01 0.01"/>
    <texture name="print" type="2d" builtin="checker" width="8" height="8" rgb1="0 0 0" rgb2="1 1 1"/>
    <material name="white" rgba="1 1 1 1"/>
    <material name="printed" texture="print"/>
  </asset>
  <worldbody>
    <body name="link">
      <geom type="mesh" mesh="ball" material="white" group="1" contype="0" conaffinity="0" pos="0.3 0 0"/>
      <geom type="mesh" mesh="ball" rgba="1 1 1 1" group="1" contype="0" conaffinity="0" pos="-0.3 0 0"/>
      <geom type="mesh" mesh="ball" rgba="0 0 1 1" group="1" contype="0" conaffinity="0" pos="0 0.3 0"/>
      <geom type="mesh" mesh="label" material="printed" group="1" contype="0" conaffinity="0"/>
      <geom type="mesh" mesh="shell" group="0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "meshes"


@pytest.fixture
def arm(tmp_path):
    trimesh.creation.icosphere(subdivisions=4, radius=1.0).export(tmp_path / "ball.obj")
    (tmp_path / "arm.xml").write_text(ARM)

    def load():
        return mujoco.MjSpec.from_file(str(tmp_path / "arm.xml"))

    load.folder = tmp_path
    return load


def compiled(arm, max_faces=600):
    spec = arm()
    simplify_visuals(spec, arm.folder, max_faces)
    return spec.compile()


def visual_points(model, body):
    """Every visible vertex of a body, in the body's frame, and the number of triangles."""
    points, faces = [], 0
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        if model.geom_bodyid[geom] != body or model.geom_group[geom] != VISUAL_GROUP or mesh < 0:
            continue
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        rotated = model.mesh_vert[first : first + count] @ matrix.reshape(3, 3).T
        points.append(rotated + model.geom_pos[geom])
        faces += int(model.mesh_facenum[mesh])
    return (np.concatenate(points) if points else np.zeros((0, 3))), faces


def test_geoms_of_one_colour_become_one_mesh(arm):
    model = compiled(arm)
    names = [model.geom(i).name for i in range(model.ngeom)]
    merged = [name for name in names if name.startswith("link_visual_")]
    assert len(merged) == 2
    colours = {tuple(model.geom(name).rgba) for name in merged}
    assert colours == {(1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 1.0)}
    assert model.ngeom == 4  # two merged, the printed label, the collision shell


def test_poses_and_scales_of_the_parts_are_kept(arm):
    points, faces = visual_points(compiled(arm), 1)
    np.testing.assert_allclose(points.min(0), (-0.4, -0.1, -0.1), atol=2e-3)
    np.testing.assert_allclose(points.max(0), (0.4, 0.4, 0.1), atol=2e-3)
    assert faces <= 600 + 5120  # the limit, and the printed label


def test_a_printed_part_and_collision_geometry_stay_as_they_were(arm):
    before, after = arm().compile(), compiled(arm)
    for model in (before, after):
        shells = [i for i in range(model.ngeom) if model.geom_group[i] == 0]
        assert [int(model.mesh_facenum[model.geom_dataid[i]]) for i in shells] == [5120]
        printed = [i for i in range(model.ngeom) if model.geom_matid[i] == model.material("printed").id]
        assert [int(model.mesh_facenum[model.geom_dataid[i]]) for i in printed] == [5120]
    assert "ball" not in [after.mesh(i).name for i in range(after.nmesh)]
    assert "shell" in [after.mesh(i).name for i in range(after.nmesh)]


def test_visual_geoms_have_no_collisions_and_no_mass(arm):
    before, after = arm().compile(), compiled(arm)
    for name in ("link_visual_0", "link_visual_1"):
        geom = after.geom(name)
        assert (int(geom.contype[0]), int(geom.conaffinity[0]), int(geom.group[0])) == (0, 0, VISUAL_GROUP)
    assert after.body("link").mass[0] <= before.body("link").mass[0]


def test_the_budget_is_shared_by_the_size_of_the_parts(arm):
    model = compiled(arm, max_faces=600)
    faces = sorted(int(model.mesh(f"link_visual_{i}").facenum[0]) for i in (0, 1))
    assert faces[0] <= 205
    assert faces[1] <= 410


def test_a_second_build_reads_the_cache(arm, cache, monkeypatch):
    first = compiled(arm)
    assert len(list(cache.glob("*.npz"))) == 2
    assert not list(cache.glob(".*"))

    def refuse(*args, **kwargs):
        raise AssertionError("simplified again")

    monkeypatch.setattr(fast_simplification, "simplify", refuse)
    np.testing.assert_array_equal(compiled(arm).mesh_vert, first.mesh_vert)


def test_another_budget_or_another_file_is_another_entry(arm, cache):
    compiled(arm, 600)
    compiled(arm, 900)
    assert len(list(cache.glob("*.npz"))) == 4
    trimesh.creation.icosphere(subdivisions=4, radius=0.9).export(arm.folder / "ball.obj")
    points, _ = visual_points(compiled(arm, 600), 1)
    assert len(list(cache.glob("*.npz"))) == 6
    np.testing.assert_allclose(points.max(0), (0.39, 0.39, 0.09), atol=5e-3)


@pytest.mark.parametrize("content", [b"", b"not an archive", None], ids=["empty", "garbage", "cut off"])
def test_a_broken_cache_file_is_made_again(arm, cache, caplog, content):
    first = compiled(arm)
    broken = sorted(cache.glob("*.npz"))[0]
    whole = broken.read_bytes()
    broken.write_bytes(whole[: len(whole) // 2] if content is None else content)
    with caplog.at_level(logging.WARNING):
        again = compiled(arm)
    assert f"The cached mesh {broken} cannot be read" in caplog.text
    assert "it is made again" in caplog.text
    np.testing.assert_array_equal(again.mesh_vert, first.mesh_vert)
    with np.load(broken, allow_pickle=False) as stored:
        assert sorted(stored) == ["faces", "vertices"]


@pytest.mark.slow
def test_the_arms_links_keep_their_bounds_within_two_millimetres(cache):
    """Simplified visuals of each link have the same bounds, and a small part of the triangles."""
    scenario = PickCube().scenario
    full, simple = (build_model(scenario, simplify=simplify) for simplify in (False, True))
    before = after = 0
    for body in range(full.nbody):
        points, faces = visual_points(full, body)
        ours, fewer = visual_points(simple, simple.body(full.body(body).name).id)
        assert bool(len(points)) == bool(len(ours))
        if len(points):
            np.testing.assert_allclose(ours.min(0), points.min(0), atol=2e-3)
            np.testing.assert_allclose(ours.max(0), points.max(0), atol=2e-3)
        before, after = before + faces, after + fewer
    assert after < before / 5
    np.testing.assert_allclose(simple.body_mass, full.body_mass)
    np.testing.assert_allclose(simple.body_inertia, full.body_inertia)
