import numpy as np
import pytest

from envs.rotations import from_yaw
from roboverse_learn.data.augmentation.pose import Pose, angle_rad, distance_m, partly


def pose(x, y, z, yaw_deg=0.0):
    return Pose(np.array([x, y, z]), from_yaw(np.radians(yaw_deg)))


def test_object_that_moved_and_turned_takes_the_hand_with_it():
    source, now = pose(1.0, 0.0, 0.0), pose(0.0, 2.0, 0.0, yaw_deg=90.0)
    hand = pose(1.5, 0.0, 0.1, yaw_deg=10.0)  # half a metre before the object, along its x axis
    moved = now @ source.inverse() @ hand
    assert moved.pos == pytest.approx([0.0, 2.5, 0.1])
    assert moved.rot == pytest.approx(from_yaw(np.radians(100.0)))


def test_inverse_undoes_a_pose():
    frame = pose(0.3, -0.2, 0.1, yaw_deg=35.0)
    back = frame.inverse() @ frame
    assert back.pos == pytest.approx([0, 0, 0]) and back.rot == pytest.approx([1, 0, 0, 0])


def test_poses_of_a_path_are_moved_at_once():
    path = Pose(np.array([[1.0, 0, 0], [2.0, 0, 0]]), from_yaw(np.zeros(2)))
    moved = pose(0.0, 0.0, 1.0, yaw_deg=90.0) @ path
    np.testing.assert_allclose(moved.pos, [[0, 1, 1], [0, 2, 1]], atol=1e-12)


def test_distance_and_angle_between_poses():
    one, other = pose(0, 0, 0, yaw_deg=170.0), pose(3.0, 4.0, 0, yaw_deg=-170.0)
    assert distance_m(one, other) == pytest.approx(5.0)
    assert np.degrees(angle_rad(one, other)) == pytest.approx(20.0)


@pytest.mark.parametrize(("long_way", "half_deg"), [(False, 30.0), (True, -150.0)])
def test_rotation_by_half_its_angle_either_way_round(long_way, half_deg):
    turned = partly(from_yaw(np.radians(60.0)), np.array([0.0, 0.5, 1.0]), long_way=long_way)
    expected = [from_yaw(np.radians(angle)) for angle in (0.0, half_deg, 2 * half_deg)]
    for found, wanted in zip(turned, expected, strict=True):
        assert abs(found @ wanted) == pytest.approx(1.0)


def test_no_rotation_has_no_part():
    np.testing.assert_array_equal(partly(np.array([1.0, 0, 0, 0]), np.ones(2)), [[1, 0, 0, 0]] * 2)
