"""Ways of a hand in any orientation, at places that are known."""

import numpy as np
import pytest

from envs.rotations import to_matrix
from envs.tasks.arm_at_table import chain_at_rest
from envs.tasks.skills.path import Path
from envs.tasks.tabletop import FRANKA_AT_TABLE, GRASP_CLOSED_M, GRASP_OPEN_M

REST = to_matrix(chain_at_rest(FRANKA_AT_TABLE)[1])
BEGIN = np.array([0.0, 0.0, 0.3])


def path(gripper=GRASP_OPEN_M, pace=1.0):
    return Path(FRANKA_AT_TABLE, BEGIN, REST, gripper, pace)


def about_z(angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def test_the_time_follows_from_the_way_or_from_the_turn():
    there = BEGIN + np.array([0.1, 0.0, 0.0])
    far, turned = path(pace=2.0).to(there).to(there, about_z(1.0) @ REST).waypoints
    assert far.duration_s == pytest.approx(2.0 * (0.15 + 0.17))
    assert turned.duration_s == pytest.approx(2.0 * (0.15 + 0.55))
    assert (far.yaw, turned.yaw) == (pytest.approx(0.0), pytest.approx(1.0))


def test_a_grasp_opens_before_it_moves_on_and_closes_where_it_ends():
    pos = np.array([0.1, 0.0, 0.02])
    opens, comes, closes = path(gripper=GRASP_CLOSED_M).grasp(pos).waypoints
    assert [stop.gripper for stop in (opens, comes, closes)] == [GRASP_OPEN_M, GRASP_OPEN_M, GRASP_CLOSED_M]
    np.testing.assert_array_equal([opens.pos, comes.pos, closes.pos], [BEGIN, pos, pos])


def test_a_hand_that_lets_go_draws_back_from_where_its_fingers_point():
    opens, back = path(gripper=GRASP_CLOSED_M).let_go().waypoints
    np.testing.assert_array_equal(opens.pos, BEGIN)
    np.testing.assert_allclose(back.pos - BEGIN, -0.09 * REST[:, 2])
    assert back.pos[2] > BEGIN[2]  # at rest the hand points down
    assert opens.gripper == back.gripper == GRASP_OPEN_M


def test_a_push_is_slow_along_its_line_alone_with_closed_fingers():
    start, end, after = (np.array([x, 0.0, 0.1]) for x in (0.1, 0.2, 0.1))
    _, comes, pushes, withdraws = way = path().push(start, end, after, slow=3.0).waypoints
    assert {stop.gripper for stop in way} == {GRASP_CLOSED_M}
    np.testing.assert_array_equal([comes.pos, pushes.pos, withdraws.pos], [start, end, after])
    assert pushes.duration_s == pytest.approx(3.0 * withdraws.duration_s)
