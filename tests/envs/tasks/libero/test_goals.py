"""LIBERO's predicates against states computed by hand."""

import math

import numpy as np
import pytest
import torch

from envs.core.errors import SimulatorError
from envs.kinematics.object_parts import parts_of
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.libero.arenas import ARENAS
from envs.tasks.libero.bddl import parse_problem
from envs.tasks.libero.goals import (
    DRAWER,
    MICROWAVE,
    STOVE,
    Goal,
    in_site,
    opened,
    over_object,
    over_site,
    shut,
)
from envs.tasks.libero.scene import LiberoScene

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
QUARTER_ABOUT_Y = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
QUARTER_ABOUT_Z = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))

CABINET = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="object">
  <geom type="box" size=".1 .1 .1"/>
  <site name="top_side" type="box" pos="0 0 .1" size=".1 .1 .001"/>
  <body name="drawer"><joint name="top" type="slide" axis="0 1 0" range="-.16 .01"/>
    <geom type="box" size=".05 .05 .01"/>
    <site name="top_region" type="box" pos="0 0 .05" size=".03 .06 .1"
      quat="0.70710678 0 0.70710678 0"/></body>
  <body name="drawer2"><joint name="bottom" type="slide" axis="0 1 0" range="-.16 .01"/>
    <geom type="box" size=".05 .05 .01"/></body>
</body></worldbody></mujoco>"""

TASK = """(define (problem LIBERO_Tabletop_Manipulation) (:domain robosuite) (:language do it)
  (:regions (front (:target main_table) (:ranges ((0.1 0.2 0.2 0.3))))
    (top_region (:target cabinet_1)) (top_side (:target cabinet_1)))
  (:fixtures main_table - table cabinet_1 - wooden_cabinet)
  (:objects bowl_1 - bowl plate_1 - plate) (:obj_of_interest bowl_1)
  (:init (On bowl_1 main_table_front))
  (:goal (And (On bowl_1 plate_1) (In bowl_1 cabinet_1_top_region) (On bowl_1 cabinet_1_top_side)
    (On bowl_1 main_table_front) (Open cabinet_1_top_region) (Close cabinet_1) (Open cabinet_1))))"""


def vectors(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def test_a_point_is_in_a_site_turned_by_a_quarter():
    """Half sizes (1, 2, 3) about y by a quarter become (3, 2, 1); the lower face is 1 cm lower."""
    half, rot = vectors(1.0, 2.0, 3.0), vectors(QUARTER_ABOUT_Y)
    inside = [(2.99, 1.99, 0.99), (-2.99, -1.99, -1.009), (0, 0, 0)]
    outside = [(3.01, 0, 0), (0, 2.01, 0), (0, 0, 1.001), (0, 0, -1.011), (math.nan, 0, 0)]
    for points, expected in ((inside, True), (outside, False)):
        found = in_site(vectors(*points), vectors((0.0, 0.0, 0.0)), rot, half)
        assert found.tolist() == [expected] * len(points)


def test_the_box_of_a_site_changes_with_its_yaw():
    """R of 45° about z takes half sizes (1, 0.5) to (0.354, 1.061), which is LIBERO's box along the axes."""
    rot = vectors((math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)))
    points = vectors((0.35, 1.06, 0.0), (0.36, 0.0, 0.0), (0.0, 1.07, 0.0))
    found = in_site(points, vectors((0.0, 0.0, 0.0)), rot, vectors(1.0, 0.5, 1.0))
    assert found.tolist() == [True, False, False]


def test_a_point_is_over_a_site_from_5_mm_below_its_face_to_10_cm_above():
    half, rot, at = vectors(0.1, 0.2, 0.01), vectors(UPRIGHT), vectors((1.0, 1.0, 1.0))
    z = {1.0049: False, 1.0051: True, 1.05: True, 1.1099: True, 1.1101: False}
    for height, expected in z.items():
        assert over_site(vectors((1.05, 1.15, height)), at, rot, half).item() is expected, height
    assert not over_site(vectors((1.11, 1.0, 1.05)), at, rot, half).item()
    assert not over_site(vectors((1.0, 1.21, 1.05)), at, rot, half).item()


def test_the_way_from_a_site_is_turned_by_its_rotation_not_by_its_inverse():
    """R(45°)·(0.1, 0.1) is (0, 0.141), inside; its inverse gives (0.141, 0), outside."""
    eighth = vectors((math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)))
    half, at = vectors(0.02, 0.2, 0.01), vectors((0.0, 0.0, 0.0))
    assert over_site(vectors((0.1, 0.1, 0.05)), at, eighth, half).item()
    assert not over_site(vectors((0.1, -0.1, 0.05)), at, eighth, half).item()


def test_a_point_is_over_another_within_3_cm():
    other = vectors((0.0, 0.0, 0.5))
    cases = {
        (0.0, 0.029, 0.5): True,
        (0.02, 0.02, 0.6): True,
        (0.03, 0.0, 0.6): False,
        (0.0, 0.0, 0.49): False,
    }
    for place, expected in cases.items():
        assert over_object(vectors(place), other).item() is expected


@pytest.mark.parametrize(
    ("rule", "position", "is_open", "is_shut"),
    [
        (DRAWER, -0.141, True, False),
        (DRAWER, -0.14, False, False),
        (DRAWER, 0.0, False, False),
        (DRAWER, 0.001, False, True),
        (MICROWAVE, -1.31, True, False),
        (MICROWAVE, -0.005, False, False),
        (MICROWAVE, -0.004, False, True),
        (STOVE, 0.5, True, False),
        (STOVE, 0.49, False, False),
        (STOVE, 0.0, False, False),
        (STOVE, -0.001, False, True),
        (DRAWER, math.nan, False, False),
    ],
)
def test_joints_are_open_and_shut_by_their_category(rule, position, is_open, is_shut):
    joints = vectors((position,))
    assert opened(joints, rule).tolist() == [is_open]
    assert shut(joints, rule).tolist() == [is_shut]


def test_open_asks_for_any_joint_and_shut_for_all():
    assert opened(vectors((0.005, -0.15)), DRAWER).tolist() == [True]
    assert shut(vectors((0.005, -0.15)), DRAWER).tolist() == [False]
    assert shut(vectors((0.005, 0.004)), DRAWER).tolist() == [True]


@pytest.fixture
def goal(tmp_path):
    path = tmp_path / "cabinet.xml"
    path.write_text(CABINET)
    problem = parse_problem(TASK, "a.bddl")
    ball = (GeomCfg(shape="sphere", size=(0.01,), mass_kg=0.1),)
    objects = (
        ObjectCfg(name="cabinet_1", geoms=ball, kind="fixed"),
        ObjectCfg(name="bowl_1", geoms=ball, feels=("plate_1", "cabinet_1")),
        ObjectCfg(name="plate_1", geoms=ball),
    )
    categories = problem.fixtures | problem.objects
    return Goal(
        LiberoScene(
            problem, ARENAS["table"], ScenarioCfg(objects=objects), {"cabinet_1": parts_of(path)}, categories
        )
    )


def state(bowl, *, drawers=(0.005, 0.005), touched=(1.0, 1.0)):
    def rest(pos, joints=()):
        return EntityState.at_rest(np.array([pos]), np.array(UPRIGHT), np.array([joints]).reshape(1, -1))

    cabinet = EntityState.at_rest(
        np.array([(0.5, 0.0, 1.0)]), np.array(QUARTER_ABOUT_Z), np.array([drawers], float)
    )
    things = {"cabinet_1": cabinet, "bowl_1": rest(bowl), "plate_1": rest((0.0, 0.0, 0.9))}
    things["bowl_1"].touched = None if touched is None else vectors(touched)
    return State({}, things)


def held(goal, present):
    return dict(
        zip(
            ["plate", "in", "side", "front", "open", "close", "any"],
            goal.met(present)[0].tolist(),
            strict=True,
        )
    )


def test_on_an_object_asks_for_their_contact(goal):
    assert held(goal, state((0.0, 0.01, 0.92)))["plate"]
    assert not held(goal, state((0.0, 0.01, 0.92), touched=(0.0, 1.0)))["plate"]


def test_a_region_moves_with_its_drawer(goal):
    """The cabinet at (0.5, 0, 1) is turned by a quarter: its y axis, and the drawer's way, is world -x.

    Half sizes (0.03, 0.06, 0.1) of the site, turned about its own y, are (0.1, 0.06, 0.03); along the world's
    axes (0.06, 0.1, 0.03). Its middle is 0.05 over the cabinet.
    """
    for q, middle in ((0.0, 0.5), (-0.15, 0.65)):
        for offset, expected in ((0.055, True), (-0.055, True), (0.065, False)):
            present = state((middle + offset, 0.09, 1.05), drawers=(q, 0.0))
            assert held(goal, present)["in"] is expected, (q, offset)


def test_on_a_site_of_an_object_asks_for_contact_with_it(goal):
    over = (0.5, 0.0, 1.15)
    assert held(goal, state(over))["side"]
    assert not held(goal, state(over, touched=(1.0, 0.0)))["side"]


def test_on_a_region_of_the_table_asks_for_no_contact(goal):
    """The region's middle is (0.15, 0.25) at the table's height, 0.9; half sizes (0.05, 0.05, 0.007)."""
    assert held(goal, state((0.19, 0.29, 0.95), touched=(0.0, 0.0)))["front"]
    assert not held(goal, state((0.21, 0.29, 0.95)))["front"]
    assert not held(goal, state((0.15, 0.25, 0.9)))["front"]


def test_a_region_opens_with_its_own_drawer_alone(goal):
    nowhere = (0.0, 1.0, 1.0)
    own, other = state(nowhere, drawers=(-0.15, 0.005)), state(nowhere, drawers=(0.005, -0.15))
    assert held(goal, own)["open"] and not held(goal, other)["open"]
    assert held(goal, own)["any"] and held(goal, other)["any"] and not held(goal, other)["close"]
    assert held(goal, state(nowhere))["close"]


def test_a_simulator_that_reports_no_contact_is_refused(goal):
    with pytest.raises(SimulatorError, match="Whether 'bowl_1' is on 'plate_1' asks for their contact"):
        goal.met(state((0.0, 0.0, 0.92), touched=None))
