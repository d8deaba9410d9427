import math
from collections import Counter

import pytest

from envs.core.errors import UnknownNameError
from envs.randomization.camera_poses import CAMERA_POSES, place_camera
from envs.scenario import CameraCfg


def test_there_are_59_poses_most_of_which_face_the_robot():
    assert len(CAMERA_POSES) == 59
    assert len({pose.pos for pose in CAMERA_POSES.values()}) == 59
    sides = Counter(abs(pose.azimuth_deg) >= 80 for pose in CAMERA_POSES.values())
    assert sides == {False: 53, True: 6}


def test_every_pose_is_on_the_sphere_above_the_table():
    for pose in CAMERA_POSES.values():
        assert math.dist(pose.pos, (0, 0, 0)) == pytest.approx(1.5)
        assert pose.pos[2] > 0.5


def test_angles_are_azimuth_from_x_and_polar_from_z():
    assert CAMERA_POSES["az+000-pol60"].pos == pytest.approx((1.5 * math.sqrt(3) / 2, 0, 0.75))
    x, y, _ = CAMERA_POSES["az-080-pol60"].pos
    assert math.degrees(math.atan2(y, x)) == pytest.approx(-80)


def test_a_moved_camera_keeps_everything_but_its_place():
    base = CameraCfg(name="front", pos=(1, 2, 3), look_at=(0.1, 0, 0.2), fovy_deg=47.0, width=64, height=32)
    moved = place_camera(base, "az+008-pol58")
    assert moved.pos == CAMERA_POSES["az+008-pol58"].pos
    assert (moved.name, moved.look_at, moved.fovy_deg, moved.width, moved.height) == (
        "front",
        (0.1, 0, 0.2),
        47.0,
        64,
        32,
    )


def test_an_unknown_pose_gets_a_suggestion():
    base = CameraCfg(name="front", pos=(1, 2, 3), look_at=(0, 0, 0))
    with pytest.raises(
        UnknownNameError, match=r"Unknown camera pose 'az000-pol60'. Did you mean 'az.000-pol60'"
    ):
        place_camera(base, "az000-pol60")
