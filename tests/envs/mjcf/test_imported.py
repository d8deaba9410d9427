"""Objects of other projects' files: cleaned, simplified, cached."""

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from envs.core.errors import ConfigError
from envs.mjcf.imported import imported
from envs.mjcf.textured_mesh import TexturedMesh, box_mesh
from envs.rotations import rotate

FILE = """<mujoco model="mug"><compiler meshdir="parts"/><size njmax="500"/><option timestep="1"/>
<asset><mesh name="shape" file="shape.msh" scale="2 2 2"/>
  <texture name="t" type="2d" file="image.png"/><texture name="t" type="2d" file="absent.png"/>
  <material name="m" texture="t" reflectance=".5"/></asset>
<default>stray text<default class="c"><geom rgba="1 0 0 1"/></default></default>
<worldbody><body><light pos="0 0 1"/><body name="object">
  <geom type="mesh" mesh="shape" material="m" contype="0" conaffinity="0" group="1"/>
  <geom class="c" type="box" size=".1 .1 .1" group="0" density="100"/>
  <site name="top" pos="0 0 .1" size=".01"/>
  <body name="lid" pos="0 0 .1"><joint name="hinge" axis="0 1 0" range="0 1"/>
    <geom type="box" size=".1 .1 .01" group="0" mass=".5"/></body>
</body><site name="bottom_site"/></body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "mug"
    (folder / "parts").mkdir(parents=True)
    (folder / "mug.xml").write_text(FILE)
    sphere = trimesh.creation.icosphere(4, 0.1)
    points = np.asarray(sphere.vertices, np.float32)
    uv = np.stack([points[:, 0] * 5 + 0.5, points[:, 2] * 5 + 0.5], axis=1).astype(np.float32)
    mesh = TexturedMesh(points, np.asarray(sphere.faces, np.int32), uv)
    (folder / "parts" / "shape.msh").write_bytes(mesh.msh())
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:, 32:, 0] = 255  # red where x > 0
    pixels[32:, :, 2] = 255  # blue where z > 0
    Image.fromarray(pixels).save(folder / "parts" / "image.png")
    return folder / "mug.xml"


def test_the_object_stands_alone_with_few_triangles(source):
    model = mujoco.MjModel.from_xml_path(str(imported(source, max_faces=200)))
    assert 100 < model.nmeshface <= 200
    assert [model.joint(i).name for i in range(model.njnt)] == ["hinge"] and model.nu == 0
    assert [model.site(i).name for i in range(model.nsite)] == ["top"]
    assert model.nlight == 0
    # What collides has mass, what is only seen has none: a box of 0.2 m at 100 kg/m³, and the lid.
    assert model.body_mass.sum() == pytest.approx(0.8 + 0.5)


def test_a_free_object_has_a_free_joint_with_robosuites_damping(source):
    model = mujoco.MjModel.from_xml_path(str(imported(source, free=True)))
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    np.testing.assert_allclose(model.dof_damping[:6], 0.0005)


def test_a_simplified_mesh_shows_the_same_colours(source):
    path = imported(source, max_faces=300, image_size=256)
    model = mujoco.MjModel.from_xml_path(str(path))
    texture = path.parent / next(word for word in path.read_text().split('"') if word.endswith(".png"))
    pixels = np.asarray(Image.open(texture))
    vertices = model.mesh_pos[0] + rotate(model.mesh_quat[0], model.mesh_vert.astype(float))
    uv = model.mesh_texcoord
    for face, corners in zip(model.mesh_face, model.mesh_facetexcoord, strict=True):
        middle, at = vertices[face].mean(0), uv[corners].mean(0)
        if min(abs(middle[0]), abs(middle[2])) < 0.02:
            continue
        color = pixels[int(at[1] * len(pixels)), int(at[0] * len(pixels))]
        assert (color[0] > 128) == (middle[0] > 0) and (color[2] > 128) == (middle[2] > 0), (middle, color)


def test_another_colour_changes_the_image_alone(source):
    pixels = np.full((64, 64, 3), 255, np.uint8)
    pixels[:, 16:] = (200, 0, 0)
    Image.fromarray(pixels).save(source.parent / "parts" / "image.png")
    paths = imported(source, max_faces=300), imported(source, max_faces=300, colour="blue")
    models = [mujoco.MjModel.from_xml_path(str(path)) for path in paths]
    np.testing.assert_array_equal(models[0].mesh_vert, models[1].mesh_vert)
    np.testing.assert_array_equal(models[0].mesh_texcoord, models[1].mesh_texcoord)
    red, blue = (model.tex_data.reshape(-1, 3) for model in models)
    was_red = (red == (200, 0, 0)).all(1)
    assert was_red.sum() > 1000
    np.testing.assert_allclose(blue[was_red], [(0, 67, 200)] * was_red.sum(), atol=3)
    np.testing.assert_array_equal(blue[~was_red], red[~was_red])
    assert imported(source, max_faces=300) == paths[0]


def test_nothing_is_made_twice_and_a_changed_source_is_made_anew(source):
    first = imported(source)
    before = {path: path.stat().st_mtime_ns for path in first.parents[1].rglob("*.*")}
    assert imported(source) == first
    assert {path: path.stat().st_mtime_ns for path in first.parents[1].rglob("*.*")} == before
    source.write_text(FILE.replace('size=".1 .1 .01"', 'size=".1 .1 .02"'))
    assert imported(source) != first


def test_textured_boxes_that_are_only_seen_become_meshes(source):
    text = FILE.replace(
        '<site name="top"',
        '<geom type="box" material="m" size=".3 .2 .1" contype="0" conaffinity="0" group="1"/>'
        '<site name="top"',
    )
    source.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(imported(source)))
    assert model.nmesh == 2 and model.mesh_facenum[1] == 12


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (FILE, "<mujoco><asset>", r"mug.xml cannot be read: .*line 1"),
        ('name="object"', 'name="thing"', r"mug.xml has no body 'object'\."),
        ('file="shape.msh"', 'file="shapes.msh"', r"mug.xml names a file that is not there: .*shapes.msh"),
    ],
)
def test_a_damaged_file_is_named(source, old, new, message):
    source.write_text(FILE.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        imported(source)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "shorter than its header"),
        (b"\x05\0\0\0" * 4, "its header promises"),
        (None, "a triangle names"),
    ],
)
def test_a_damaged_mesh_is_named(source, content, message):
    mesh = TexturedMesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 9]], np.int32))
    (source.parent / "parts" / "shape.msh").write_bytes(mesh.msh() if content is None else content)
    with pytest.raises(ConfigError, match=f"shape.msh cannot be read: .*{message}"):
        imported(source)


def test_a_damaged_image_is_named(source):
    (source.parent / "parts" / "image.png").write_bytes(b"no image")
    with pytest.raises(ConfigError, match=r"image\.png cannot be read"):
        imported(source, max_faces=100)


def test_a_box_of_triangles_faces_outwards():
    mesh = box_mesh(np.array([0.1, 0.2, 0.3]), (1.0, 2.0))
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.sum(normals * corners.mean(1), axis=1) > 0).all()
    assert mesh.uv is not None and mesh.uv.max() == pytest.approx(1.2)
