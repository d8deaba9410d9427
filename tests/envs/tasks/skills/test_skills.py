"""Grasps and places from collision geometry, by hand."""

import numpy as np
import pytest

from envs.tasks.skills.clouds import Heights, Underside, box_points, thinned
from envs.tasks.skills.grasps import PAD_HALF_M, Grasp, top_grasps
from envs.tasks.skills.hands import (
    FINGER_HALF_M,
    FINGER_MOST_M,
    PALM_HALF_M,
    PALM_M,
    TIP_BELOW_M,
    hand_underside,
)
from envs.tasks.skills.moves import PRESS_M, Hand, drag, escape, pick, put

NOTHING = np.zeros((0, 3))


def rng():
    return np.random.default_rng(0)


def box(half, at=(0.0, 0.0, 0.0)):
    return box_points(np.array(half)) + np.array(at)


def bowl(radius=0.06, height=0.05):
    """A ring of wall on a floor, its bottom at z = 0."""
    angles = np.linspace(0, 2 * np.pi, 120)
    wall = [(radius * np.cos(a), radius * np.sin(a), z) for a in angles for z in np.arange(0, height, 0.004)]
    floor = [(r * np.cos(a), r * np.sin(a), 0.0) for a in angles for r in np.arange(0, radius, 0.005)]
    return thinned(np.array(wall + floor), 0.004)


def test_points_cover_a_box():
    points = box((0.01, 0.02, 0.03))
    np.testing.assert_allclose(points.min(0), (-0.01, -0.02, -0.03))
    np.testing.assert_allclose(points.max(0), (0.01, 0.02, 0.03))
    on_a_side = np.isclose(np.abs(points), (0.01, 0.02, 0.03)).any(1)
    assert on_a_side.all()


def test_a_grasp_closes_on_the_narrow_sides():
    """A box 4 cm along x and 12 cm along y: the fingers close along x, so the hand is turned by a quarter."""
    best = top_grasps(box((0.02, 0.06, 0.03), (0.3, 0.1, 0.03)), NOTHING, 0.012, rng())[0]
    assert abs(abs(best.yaw) - np.pi / 2) < 0.3
    assert np.linalg.norm(best.pos[:2] - (0.3, 0.1)) < 0.03
    assert 0.012 <= best.pos[2] <= 0.06


def test_what_is_wider_than_the_hand_has_no_grasp():
    ring = np.linspace(0, 2 * np.pi, 200)
    sides = [(0.07 * np.cos(a), 0.07 * np.sin(a), z) for a in ring for z in np.arange(0, 0.1, 0.005)]
    lid = [(r * np.cos(a), r * np.sin(a), 0.1) for a in ring for r in np.arange(0, 0.07, 0.005)]
    assert top_grasps(np.array(sides + lid), NOTHING, 0.012, rng()) == []


def test_a_bowl_is_grasped_by_its_rim():
    grasps = top_grasps(bowl(), NOTHING, 0.012, rng())
    assert grasps
    for grasp in grasps[:5]:
        assert np.linalg.norm(grasp.pos[:2]) == pytest.approx(0.06, abs=0.012)


def test_without_chance_a_bowl_is_grasped_at_the_same_side_wherever_it_stands():
    """What a policy has to learn follows from where the bowl is."""
    ways = [np.array(way) for way in ((0.0, 0.0, 0.0), (0.213, -0.107, 0.0), (-0.054, 0.302, 0.4))]
    best = [top_grasps(bowl() + way, NOTHING, 0.012 + way[2], None)[0] for way in ways]
    for grasp, way in zip(best, ways, strict=True):
        np.testing.assert_allclose(grasp.pos - way, best[0].pos, atol=1e-6)
        assert (grasp.yaw, grasp.opening_m) == (best[0].yaw, best[0].opening_m)
    chosen = [top_grasps(bowl(), NOTHING, 0.012, np.random.default_rng(seed))[0].pos for seed in range(8)]
    assert np.ptp(chosen, axis=0)[:2].max() > 0.03  # by chance it is another side


def test_a_neighbour_keeps_fingers_out():
    item = box((0.02, 0.02, 0.03), (0, 0, 0.03))
    walls = np.concatenate([box((0.002, 0.2, 0.1), (x, 0, 0.1)) for x in (-0.03, 0.03)])
    grasps = top_grasps(item, walls, 0.012, rng())
    assert all(abs(grasp.yaw) < 0.6 for grasp in grasps)  # fingers close along y, where there is room


def in_hand(points, grasp):
    """Points in the hand's frame: along its depth, along the way of its fingers, and upwards."""
    cosine, sine = np.cos(grasp.yaw), np.sin(grasp.yaw)
    return (points - grasp.pos) @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def test_without_chance_fingers_close_across_the_rim():
    for radius in (0.05, 0.055, 0.06, 0.065):
        best = top_grasps(bowl(radius), NOTHING, 0.012, None)[0]
        closing = np.array([-np.sin(best.yaw), np.cos(best.yaw)])
        outwards = best.pos[:2] / np.linalg.norm(best.pos[:2])
        assert abs(closing @ outwards) > np.cos(np.radians(15))


def test_every_grasp_holds_something_and_has_room_for_fingers_and_palm():
    """A bowl beside a box and under a shelf: all grasps are looked at, one by one."""
    item = bowl() + np.array([0.2, 0.0, 0.0])
    around = np.concatenate(
        [box((0.02, 0.02, 0.05), (0.29, 0.0, 0.05)), box((0.05, 0.02, 0.01), (0.2, 0.14, 0.09))]
    )
    grasps = top_grasps(item, around, 0.012, rng())
    assert len(grasps) > 50
    assert [grasp.score for grasp in grasps] == sorted((grasp.score for grasp in grasps), reverse=True)
    for grasp in grasps:
        own, solid = in_hand(item, grasp), in_hand(np.concatenate([item, around]), grasp)
        held = own[(np.abs(own) < (PAD_HALF_M, FINGER_MOST_M, PAD_HALF_M)).all(1)]
        assert len(held) and np.abs(held[:, 1]).max() < grasp.opening_m
        x, y, z = np.abs(solid[:, 0]), np.abs(solid[:, 1]), solid[:, 2]
        assert not ((x < PALM_HALF_M[0]) & (y < PALM_HALF_M[1]) & (z > PALM_M)).any()
        beside = (y > grasp.opening_m) & (y < grasp.opening_m + 2 * FINGER_HALF_M[1])
        assert not ((x < FINGER_HALF_M[0]) & beside & (z > -TIP_BELOW_M)).any()


def test_a_place_at_the_edge_of_the_heights_rests_as_in_a_larger_grid():
    item, block = Underside.of(box((0.03, 0.03, 0.02))), box((0.05, 0.05, 0.05), (0.2, 0.0, 0.05))
    narrow = Heights([block], 0.0, (0.1, -0.1), (0.26, 0.1))
    places = np.array([(0.13, 0.0), (0.2, 0.0), (0.24, 0.02)])
    np.testing.assert_array_equal(narrow.rest(places, item), Heights([block], 0.0).rest(places, item))
    inside = places[:2]
    np.testing.assert_array_equal(narrow.rest(inside, item), narrow.rest(places, item)[:2])


def test_something_comes_to_rest_on_the_highest_thing_below_it():
    heights = Heights([box((0.05, 0.05, 0.1), (0.2, 0.0, 0.1))], ground=0.0)
    block = Underside.of(box((0.02, 0.02, 0.03)))
    rests = heights.rest(np.array([(0.2, 0.0), (0.26, 0.0), (0.3, 0.0)]), block)
    np.testing.assert_allclose(rests, (0.23, 0.23, 0.03), atol=1e-9)
    assert heights.along(np.array([0.0, 0.0]), np.array([0.5, 0.0]), block) == pytest.approx(0.23)


def test_the_underside_of_a_hand_is_its_fingers_and_its_palm():
    under = hand_underside(0.0)
    assert under.z.min() == pytest.approx(-TIP_BELOW_M, abs=1e-5)
    assert under.z.max() == pytest.approx(PALM_M, abs=1e-5)
    fingers = under.cells[under.z < 0] * 0.005
    assert np.abs(fingers[:, 0]).max() < 0.02 and np.abs(fingers[:, 1]).min() >= 0.035
    turned = hand_underside(np.pi / 2)
    assert np.abs(turned.cells[turned.z < 0][:, 1] * 0.005).max() < 0.02


def test_fingers_that_open_rest_on_a_wall_on_their_way():
    wall = Heights([box((0.1, 0.002, 0.04), (0.0, 0.03, 0.04))], ground=0.0)
    here = np.zeros((1, 2))
    (open_,) = wall.rest(here, hand_underside(0.0, 0.04))  # the wall is between the fingers
    (opening,) = wall.rest(here, hand_underside(0.0, 0.04, opens_from_m=0.0))
    assert open_ < 0.08 and opening == pytest.approx(0.08 + TIP_BELOW_M, abs=1e-5)


def test_picking_opens_comes_down_and_closes():
    grasp = Grasp(np.array([0.2, 0.1, 0.02]), 0.3, 0.04, 0.0)
    way = pick(Hand(np.array([0.0, 0.0, 0.3])), grasp, Heights([], 0.0))
    assert [point.gripper for point in way[:-1]] == [0.04] * (len(way) - 1) and way[-1].gripper == 0.0
    np.testing.assert_array_equal(way[-1].pos, grasp.pos)
    np.testing.assert_array_equal(way[-2].pos, grasp.pos)
    np.testing.assert_allclose(way[-3].pos[:2], grasp.pos[:2])


def test_carrying_goes_over_what_is_between():
    wall = box((0.01, 0.3, 0.1), (0.1, 0.0, 0.1))
    item = Underside.of(box((0.02, 0.02, 0.02)))
    grasp = Grasp(np.array([0.0, 0.0, 0.02]), 0.0, 0.03, 0.0)
    way = put(Hand(grasp.pos), grasp, item, np.array([0.2, 0.0, 0.03]), 0.0, Heights([wall], 0.0))
    assert max(point.pos[2] for point in way) > 0.2 + 0.02
    assert way[-2].gripper == 0.03 and way[-1].pos[2] > way[-2].pos[2]


def test_what_is_under_a_shelf_first_comes_out_sideways():
    shelf = box((0.1, 0.2, 0.005), (-0.07, 0.0, 0.2))
    item = Underside.of(box((0.02, 0.02, 0.02)))
    grasp = Grasp(np.array([0.0, 0.0, 0.02]), 0.0, 0.03, 0.0)
    way = escape(grasp, item, Heights([shelf], 0.0))
    assert way[0] >= 0.05 and abs(way[1]) < 0.03
    assert not escape(grasp, item, Heights([], 0.0)).any()


def test_dragging_presses_on_the_floor_and_pushes_the_rim_from_inside():
    plate = bowl(0.07, 0.02)
    alone = Heights([plate], 0.0)
    way = drag(Hand(np.array([0, 0, 0.2])), plate, np.array([0.1, 0.0]), alone, alone)
    assert all(point.gripper == 0.0 for point in way)
    end = way[-2].pos
    assert end[1] == pytest.approx(0.0, abs=1e-6) and 0.14 < end[0] < 0.17
    touch = float(alone.rest(np.zeros((1, 2)), hand_underside(way[-2].yaw, 0.0))[0])
    assert way[-3].pos[2] == end[2] == pytest.approx(touch - PRESS_M)
