"""Ways of a hand that points down, at places that are known."""

import numpy as np
import pytest

from envs.kinematics.waypoints import Waypoint
from envs.tasks.skills.from_above import grasp, push, put, set_down, shut_drawer, slide, take, wipe
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


def test_a_grasp_without_misses_is_three_stops_of_the_given_times():
    pos = np.array([0.1, 0.2, 0.02])
    over = Waypoint(pos=pos + 0.05, yaw=0.0, gripper=GRASP_OPEN_M, duration_s=1.0)
    way = grasp(over, pos, None, closed_m=0.01, down_s=0.4, settle_s=0.0, close_s=0.2, hold_s=0.3)
    assert [(stop.gripper, stop.duration_s, stop.hold_s) for stop in way] == [
        *((GRASP_OPEN_M, 1.0, 0.0), (GRASP_OPEN_M, 0.4, 0.0)),
        (0.01, 0.2, 0.3),
    ]


def test_a_hand_with_one_moving_finger_comes_down_beside_a_thing_and_moves_to_it():
    pos, clear = np.array([0.1, 0.2, 0.02]), np.array([-0.006, 0.0, 0.0])
    over = Waypoint(pos=pos + 0.05, yaw=0.3, gripper=0.02, duration_s=1.0)
    _, down, beside, closed = grasp(over, pos, None, clear=clear)
    np.testing.assert_allclose(down.pos, pos + clear)
    np.testing.assert_array_equal([beside.pos, closed.pos], [pos, pos])
    assert (down.gripper, beside.gripper, closed.gripper) == (0.02, 0.02, GRASP_CLOSED_M)


def test_what_is_set_down_is_let_go_of_at_its_place_as_the_hand_is_turned_over_it():
    spot = np.array([0.1, 0.2, 0.05])
    over = Waypoint(pos=spot + 0.06, yaw=0.3, pitch=0.1, gripper=GRASP_CLOSED_M, duration_s=1.0, hold_s=0.1)
    first, down, opened, up = set_down(over, spot, opening_m=0.03, down_s=0.6, wait_s=0.2, rise_m=0.08)
    assert first is over
    np.testing.assert_array_equal([down.pos, opened.pos], [spot, spot])
    np.testing.assert_allclose(up.pos, spot + np.array([0.0, 0.0, 0.08]))
    assert [(stop.gripper, stop.duration_s, stop.hold_s) for stop in (down, opened, up)] == [
        *((GRASP_CLOSED_M, 0.6, 0.15), (0.03, 0.3, 0.2)),
        (0.03, 0.5, 0.0),
    ]
    assert {(stop.yaw, stop.pitch) for stop in (down, opened, up)} == {(0.3, 0.1)}
    assert len(set_down(over, spot, rise_m=0.0)) == 3


def test_a_hand_slides_as_it_is_turned_and_waits_where_it_begins_and_ends():
    last = Waypoint(pos=np.zeros(3), yaw=0.3, roll=0.2, gripper=0.01, duration_s=1.0, hold_s=0.5)
    places = [np.array([x, 0.0, 0.02]) for x in (0.1, 0.12, 0.3)]
    way = slide(last, places, (0.5, 0.2, 1.5), settle_s=0.1, hold_s=0.4)
    np.testing.assert_array_equal([stop.pos for stop in way], places)
    assert [(stop.duration_s, stop.hold_s) for stop in way] == [(0.5, 0.1), (0.2, 0.0), (1.5, 0.4)]
    assert {(stop.yaw, stop.roll, stop.gripper) for stop in way} == {(0.3, 0.2, 0.01)}
    (drawn,) = slide(last, places[-1:], (2.0,), settle_s=0.1, hold_s=0.3)  # no beginning
    assert (drawn.duration_s, drawn.hold_s) == (2.0, 0.3) and drawn.pos is places[-1]
    with pytest.raises(ValueError):
        slide(last, places, (0.5, 0.2))


def test_a_push_goes_down_beside_its_start_and_back_before_it_rises():
    start, end = np.array([0.1, 0.0, 0.03]), np.array([0.2, 0.0, 0.03])
    *_, first, touches, pushes, back, up = push(HAND, start, end, 0.0, 0.2, rng())
    assert first.pos[0] < 0.1 and first.pos[1:].tolist() == [0.0, 0.03]
    np.testing.assert_array_equal([touches.pos, pushes.pos, back.pos], [start, end, start])
    assert (up.pos[2], pushes.hold_s) == (0.2, 0.1)
    assert 0.3 + 0.9 <= pushes.duration_s <= 0.3 + 1.1  # 0.1 m at 0.1 m/s, at a pace that is drawn


def test_a_wipe_comes_down_where_its_line_begins_and_follows_it_at_an_even_pace():
    line = [np.array([x, 0.1, 0.0]) for x in (0.1, 0.13, 0.22)]
    way = wipe(HAND, line, 0.2, 0.08, rng())
    *lead, begins, along, ends = way
    np.testing.assert_array_equal([begins.pos, along.pos, ends.pos], line)
    assert min(stop.pos[2] for stop in lead) >= 0.08
    assert {(stop.yaw, stop.gripper) for stop in way} == {(0.2, GRASP_CLOSED_M)}
    assert ends.duration_s / along.duration_s == pytest.approx(3.0)
    assert along.duration_s == pytest.approx(0.03 / 0.12)


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
