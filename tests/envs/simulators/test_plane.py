"""Planes as triangles."""

import numpy as np
import pytest

from envs.simulators.plane import plane_mesh


@pytest.mark.parametrize(("size", "half"), [((2.0, 3.0, 0.1), (2.0, 3.0)), ((0.0, 3.0, 0.1), (50.0, 3.0))])
def test_a_plane_faces_up_and_a_side_of_0_is_without_end(size, half):
    vertices, faces, normals, metres = plane_mesh(np.array(size))
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_array_equal(across, np.tile([0.0, 0.0, 4 * half[0] * half[1]], (2, 1)))
    np.testing.assert_array_equal(normals, np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_array_equal(metres, vertices[:, :2] + half)
