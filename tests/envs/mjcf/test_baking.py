"""Simplified meshes: welded vertices, and normals that are smooth within a crease."""

import numpy as np
import pytest

from envs.mjcf.baking import baked
from envs.mjcf.textured_mesh import TexturedMesh


def folded(angle_rad: float) -> TexturedMesh:
    """Returns two triangles that share an edge along y: one level, of area 1, one bent up, of area 0.5."""
    vertices = [(0, 0, 0), (0, 1, 0), (-2, 0, 0), (np.cos(angle_rad), 0, np.sin(angle_rad))]
    return TexturedMesh(np.array(vertices, np.float32), np.array([(0, 1, 2), (1, 0, 3)], np.int32))


@pytest.mark.parametrize("angle_deg", [50.0, 70.0])
def test_normals_are_weighted_by_area_within_a_crease_of_60_degrees(angle_deg):
    angle = np.radians(angle_deg)
    mesh = folded(angle)
    dense = TexturedMesh(mesh.vertices, mesh.faces, np.zeros((4, 2), np.float32))
    normals = baked(mesh, dense, np.zeros((4, 4, 3), np.uint8), 16)[0].normals
    assert normals is not None
    level, bent = np.array([0.0, 0.0, 1.0]), np.array([-np.sin(angle), 0.0, np.cos(angle)])
    mean = 1.0 * level + 0.5 * bent
    shared = [mean / np.linalg.norm(mean)] * 2 if angle_deg < 60.0 else [level, bent]
    expected = [shared[0], shared[0], level, shared[1], shared[1], bent]
    np.testing.assert_allclose(normals, expected, atol=1e-6)


def test_vertices_of_one_place_are_one_but_for_a_seam_of_the_texture():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)], np.float32)
    faces = np.array([(0, 1, 2), (3, 4, 5)], np.int32)
    assert len(TexturedMesh(vertices, faces).welded().vertices) == 4
    uv = vertices[:, :2].copy()
    assert len(TexturedMesh(vertices, faces, uv).welded().vertices) == 4
    uv[4] += 0.5
    welded = TexturedMesh(vertices, faces, uv).welded()
    assert len(welded.vertices) == 5
    np.testing.assert_array_equal(welded.vertices[welded.faces], vertices[faces])
    assert welded.uv is not None
    np.testing.assert_array_equal(welded.uv[welded.faces], uv[faces])
