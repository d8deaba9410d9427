"""Ways of a hand that points down, at places that are known."""

import numpy as np
import pytest

from envs.kinematics.waypoints import Waypoint
from envs.tasks.skills.from_above import grasp, put, shut_drawer, take
from envs.tasks.skills.moves import Hand
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M

HAND = Hand(np.array([0.0, 0.0, 0.3]))


def rng():
    return np.random.default_rng(0)


def test_a_grasp_ends_closed_at_its_place_as_the_hand_is_turned_over_it():
    pos = np.array([0.1, 0.2, 0.02])
    over = Waypoint(pos=pos + 0.05, yaw=0.3, pitch=0.1, gripper=GRASP_OPEN_M, duration_s=1.0)
    *_, down, closed = way = grasp(over, pos, rng(), down_s=0.4, close_s=0.2)
    np.testing.assert_array_equal([down.pos, closed.pos], [pos, pos])
    assert (down.gripper, down.duration_s, closed.gripper, closed.duration_s) == (
        *(GRASP_OPEN_M, 0.4),
        *(GRASP_CLOSED_M, 0.2),
    )
    assert {(stop.yaw, stop.pitch) for stop in way} == {(0.3, 0.1)}


def test_what_was_taken_is_put_down_from_where_it_is_held():
    held = HAND.after(take(HAND, np.array([0.1, 0.0, 0.02]), 0.5, 0.2, rng()))
    np.testing.assert_allclose(held.pos, (0.1, 0.0, 0.2))
    first = put(held, np.array([0.3, 0.0, 0.02]), 0.5, 0.2, rng())[0]
    assert held.yaw == 0.5 and first.pos[2] == pytest.approx(0.2)  # it is at the height of travel already


def test_a_drawer_is_pushed_by_as_much_as_it_is_out_and_a_little_beyond():
    """Closed fingers come down on the outer side of the bar, and end there when the drawer is shut."""
    bar, ahead = np.array([0.2, 0.1, 0.1]), np.array([0.0, -1.0, 0.0])
    way = shut_drawer(HAND, bar, ahead, 0.15, 0.0, 0.3, rng())
    assert {stop.gripper for stop in way} == {GRASP_CLOSED_M}
    low = [float((stop.pos - bar) @ ahead) for stop in way if stop.pos[2] == pytest.approx(0.1)]
    assert max(low) - 0.15 == pytest.approx(-0.009 - 0.022 + 0.006)
    assert max(low[:2]) < -0.009 - 0.022
