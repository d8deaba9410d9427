"""The way of a held thing to before its place and into it, and the pose that a hand brings it to."""

import numpy as np
import pytest

from envs.kinematics.waypoints import Waypoint
from envs.rotations import conjugate, from_euler, from_yaw, multiply, rotate
from envs.tasks.arm_at_table import chain_at_rest
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import DOWN, FAR_M, UP, Insertion, insertion_way
from envs.tasks.tabletop import FRANKA_AT_TABLE, GRASP_CLOSED_M

HAND = np.array([0.1, 0.0, 0.3])
SAG_M = np.array([0.0, 0.0, 0.004])
GOAL = Pose.level(np.array([0.2, 0.1, 0.15]), 0.4)


def from_x(turn):
    return np.array([np.cos(turn), np.sin(turn), 0.0])


AHEAD = from_x(0.4)


def held(pose):
    """A thing in a hand that points down, 4 mm below where its targets are."""
    now = Waypoint(pos=HAND + SAG_M, yaw=0.0, gripper=GRASP_CLOSED_M, duration_s=0.0)
    return Held(FRANKA_AT_TABLE, now, HAND, pose)


def where(into=AHEAD, **given):
    return Insertion(goal=GOAL, into=into, back_m=0.1, exact_m=0.002, exact_rad=0.02, **given)


def brought(start, way):
    """The pose of the thing when the hand, which sags as before, is at a waypoint."""
    rest = chain_at_rest(FRANKA_AT_TABLE)[1]
    turned = multiply(multiply(from_euler(way.turn), rest), conjugate(rest))
    return Pose(way.pos - SAG_M + rotate(turned, start.pos - HAND), multiply(turned, start.rot))


def rng():
    return np.random.default_rng(0)


def test_a_hand_brings_what_it_holds_to_a_pose_with_what_its_load_takes():
    start = Pose(np.array([0.1, 0.02, 0.25]), from_euler(np.array([0.3, -0.1, 0.05])))
    way = held(start).to(GOAL, 0.7, 0.2)
    reached = brought(start, way)
    np.testing.assert_allclose(reached.pos, GOAL.pos, atol=1e-9)
    assert reached.turn_to(GOAL) < 1e-6
    assert (way.duration_s, way.hold_s, way.gripper) == (0.7, 0.2, GRASP_CLOSED_M)


def test_the_angle_between_poses_is_that_of_the_smaller_turn():
    a, b = Pose(HAND, from_yaw(np.array(0.2))), Pose(HAND, -from_yaw(np.array(1.5)))
    assert a.turn_to(b) == b.turn_to(a) == pytest.approx(1.3)


@pytest.mark.parametrize(("way", "turn"), [(AHEAD, 0.6), (UP, np.pi / 2), (-from_x(1.0), np.pi)])
def test_a_pose_turns_as_little_as_points_its_x_axis_along_a_direction(way, turn):
    """A roll about that axis stays: a needle is as good however it is rolled."""
    for roll in (0.0, 1.5):
        start = Pose(HAND, from_euler(np.array([1.0, 0.0, roll])))
        pointing = start.pointing(way)
        np.testing.assert_allclose(pointing.ahead, way, atol=1e-9)
        assert start.turn_to(pointing) == pytest.approx(turn)
        np.testing.assert_array_equal(pointing.pos, HAND)


@pytest.mark.parametrize(("roll", "left"), [(0.2, 0.2), (1.5, np.pi / 2 - 1.5), (-3.0, np.pi - 3.0)])
def test_a_square_thing_is_rolled_to_the_nearest_side(roll, left):
    start = Pose(HAND, multiply(GOAL.rot, from_euler(np.array([0.0, 0.0, roll]))))
    rolled = GOAL.rolled(start, 4)
    np.testing.assert_allclose(rolled.ahead, GOAL.ahead)
    assert start.turn_to(rolled) == pytest.approx(left)
    assert GOAL.rolled(start, 1).turn_to(GOAL) == 0.0


@pytest.mark.parametrize("into", [AHEAD, DOWN])
def test_what_is_far_goes_to_before_the_place_and_misses_it_first(into):
    start = Pose(GOAL.pos - 0.1 * into + np.array([0.0, -0.2, 0.05]), from_yaw(np.array(1.0)))
    missed, corrected = insertion_way(held(start), where(into), rng())
    reached = brought(start, corrected)
    np.testing.assert_allclose(reached.pos, GOAL.pos - 0.1 * into, atol=1e-9)
    assert reached.turn_to(GOAL) < 1e-6
    off = brought(start, missed).pos - reached.pos
    assert off @ into == pytest.approx(-0.02)  # not nearer to the place
    assert 0.001 < np.linalg.norm(off + 0.02 * into) < 0.1
    if into is AHEAD:
        assert off[2] > 0.0, "what holds the hole may be below"


def test_what_is_lower_than_the_place_rises_first():
    start = Pose(GOAL.pos + np.array([0.1, 0.0, 0.02]), GOAL.rot)
    rise, *rest = insertion_way(held(start), where(DOWN), rng())
    np.testing.assert_allclose(rise.pos, HAND + SAG_M + 0.08 * UP)
    assert len(rest) == 2
    high = Pose(start.pos + 0.08 * UP, GOAL.rot)
    assert len(insertion_way(held(high), where(DOWN), rng())) == 2


@pytest.mark.parametrize(
    ("off_m", "turned", "ahead_m"), [(0.0019, 0.0, 0.0), (0.0, 0.019, 0.0), (0.019, 0.05, 0.031)]
)
def test_what_is_lined_up_or_part_of_the_way_in_is_inserted(off_m, turned, ahead_m):
    pos = GOAL.pos - (0.1 - ahead_m) * AHEAD + off_m * UP
    start = Pose(pos, from_yaw(np.array(0.4 + turned)))
    (way,) = insertion_way(held(start), where(), rng())
    np.testing.assert_allclose(brought(start, way).pos, GOAL.pos, atol=1e-9)
    assert way.duration_s == pytest.approx(0.4 + (0.1 - ahead_m) / 0.125)
    assert way.gripper == GRASP_CLOSED_M


@pytest.mark.parametrize(("off_m", "turned"), [(0.0021, 0.0), (0.0, 0.021), (FAR_M - 1e-4, 0.3)])
def test_what_is_near_the_line_is_corrected(off_m, turned):
    start = Pose(GOAL.pos - 0.1 * AHEAD + off_m * UP, from_yaw(np.array(0.4 + turned)))
    (way,) = insertion_way(held(start), where(), rng())
    np.testing.assert_allclose(brought(start, way).pos, GOAL.pos - 0.1 * AHEAD, atol=1e-9)


def test_what_is_let_go_of_is_lined_up_even_part_of_the_way_in_and_the_hand_draws_back():
    part_in = Pose(GOAL.pos - 0.05 * DOWN + np.array([0.01, 0.0, 0.0]), GOAL.rot)
    (way,) = insertion_way(held(part_in), where(DOWN, opening_m=0.03), rng())
    np.testing.assert_allclose(brought(part_in, way).pos, GOAL.pos - 0.1 * DOWN, atol=1e-9)
    lined = Pose(GOAL.pos - 0.1 * DOWN, GOAL.rot)
    inside, opened, back = insertion_way(held(lined), where(DOWN, opening_m=0.03), rng())
    assert [stop.gripper for stop in (inside, opened, back)] == [GRASP_CLOSED_M, 0.03, 0.03]
    np.testing.assert_allclose(opened.pos, inside.pos)
    np.testing.assert_allclose(back.pos, inside.pos + 0.14 * UP)


def test_a_long_way_in_goes_step_by_step_and_lets_go_after_the_last_one():
    given = where(DOWN, step_m=0.06)
    lined = Pose(GOAL.pos - 0.1 * DOWN, GOAL.rot)
    (first,) = insertion_way(held(lined), given, rng())
    reached = brought(lined, first)
    np.testing.assert_allclose(reached.pos, GOAL.pos - 0.04 * DOWN, atol=1e-9)
    off = Pose(reached.pos + np.array([0.005, 0.0, 0.0]), from_yaw(np.array(0.5)))
    (second,) = insertion_way(held(off), given, rng())
    np.testing.assert_allclose(brought(off, second).pos, GOAL.pos, atol=1e-9)
    assert brought(off, second).turn_to(GOAL) < 1e-6
    assert first.duration_s == pytest.approx(0.4 + 0.06 / 0.125)
    letting_go = where(DOWN, step_m=0.06, opening_m=0.03)
    assert [len(insertion_way(held(thing), letting_go, rng())) for thing in (lined, reached)] == [1, 3]
