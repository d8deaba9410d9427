"""Ways of a hand that moves a part along its joint."""

import numpy as np
import pytest

from envs.kinematics.waypoints import Waypoint
from envs.tasks.skills.joints import along_joint


def on_arc(angle):
    """A hand that holds the handle of a door 0.3 m wide, and turns with it."""
    pos = 0.3 * np.array([np.cos(angle), np.sin(angle), 0.0])
    return Waypoint(pos=pos, yaw=angle, gripper=0.0, duration_s=0.4)


def test_the_hand_is_on_the_arc_at_every_stop_and_does_not_return_to_where_it_is():
    way = along_joint(on_arc, 0.2, 1.0, 4)
    assert [stop.yaw for stop in way] == pytest.approx([0.4, 0.6, 0.8, 1.0])
    np.testing.assert_allclose([np.linalg.norm(stop.pos) for stop in way], 0.3)
    assert sum(stop.duration_s for stop in way) == pytest.approx(1.6)


def test_a_joint_moves_back_too():
    assert [stop.yaw for stop in along_joint(on_arc, 1.0, 0.2, 2)] == pytest.approx([0.6, 0.2])
