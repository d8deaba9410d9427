"""Drift of states whose distances are known."""

import math

import numpy as np
import pytest
import torch

from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, ScenarioCfg
from envs.state import EntityState, State
from roboverse_learn.sim2sim.parity.drift import drift, over_time

BOX = GeomCfg(shape="box", size=(0.1, 0.1, 0.1), mass_kg=1.0)
DOOR = LinkCfg(name="door", geoms=(BOX,), joint=ObjectJointCfg(kind="hinge", axis=(0, 0, 1), range=(-1, 1)))
SCENE = ScenarioCfg(
    objects=(
        ObjectCfg(name="near", geoms=(BOX,)),
        ObjectCfg(name="far", geoms=(BOX,)),
        ObjectCfg(name="cupboard", geoms=(BOX,), links=(DOOR,), kind="fixed"),
        ObjectCfg(name="goal", geoms=(BOX,), kind="marker"),
    )
)


def states(*, near=(0.0, 0.0, 0.0), far=(0.0, 0.0, 0.0), rot=(1.0, 0.0, 0.0, 0.0), door=0.0, goal=0.0):
    rest = np.array([1.0, 0.0, 0.0, 0.0])
    objects = {
        "near": EntityState.at_rest(np.tile(near, (2, 1)), rest),
        "far": EntityState.at_rest(np.tile(far, (2, 1)), np.array(rot)),
        "cupboard": EntityState.at_rest(np.zeros((2, 3)), rest, np.full((2, 1), door)),
        "goal": EntityState.at_rest(np.full((2, 3), goal), rest),
    }
    return State({}, objects)


def turned(angle):
    return (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))


def test_drift_is_that_of_the_farthest_free_object():
    found = drift(SCENE, states(), states(near=(0.0, 0.0, 0.1), far=(0.3, 0.0, 0.4), door=-0.25, goal=9.0))
    assert set(found) == {"objects_m", "objects_rad", "object_joints"}
    np.testing.assert_allclose(found["objects_m"], [0.5, 0.5])
    np.testing.assert_allclose(found["object_joints"], [0.25, 0.25])


@pytest.mark.parametrize("angle", [1e-9, 0.2, math.pi - 1e-3])
def test_small_and_large_angles_are_exact(angle):
    np.testing.assert_allclose(
        drift(SCENE, states(), states(rot=turned(angle)))["objects_rad"], angle, rtol=1e-6
    )


def test_quaternion_and_its_negative_have_no_angle():
    found = drift(SCENE, states(rot=turned(0.3)), states(rot=tuple(-x for x in turned(0.3))))
    np.testing.assert_allclose(found["objects_rad"], 0.0, atol=1e-15)


def test_equal_states_have_no_drift():
    for values in drift(SCENE, states(rot=turned(0.3)), states(rot=turned(0.3))).values():
        assert not values.any()


def test_another_precision_is_compared_in_double():
    single = states(near=(0.25, 0.0, 0.0)).to("cpu", torch.float32)
    np.testing.assert_array_equal(drift(SCENE, states(), single)["objects_m"], [0.25, 0.25])


def test_curves_end_where_half_of_the_episodes_do():
    curves = over_time([np.array([0.0, 1.0]), np.array([2.0, 3.0, 4.0]), np.array([4.0, 5.0, 6.0, 7.0])])
    assert curves["median"] == [2.0, 3.0, 5.0]
    assert curves["p90"] == pytest.approx([3.6, 4.6, 5.8])
