"""Robots in the compiled model: free bases, and masses, shapes and places that replace a file's."""

import dataclasses

import mujoco
import numpy as np
import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.mjcf.model import build_model
from envs.scenario import CameraCfg, SiteCfg
from tests.contracts.walker import MASS_KG, SCENARIO, WALKER


def model_of(**changes):
    robot = dataclasses.replace(WALKER, **changes)
    return build_model(dataclasses.replace(SCENARIO, robots=(robot,)))


def test_the_root_gets_a_free_joint_and_nothing_of_what_carried_it_is_left():
    model = model_of()
    assert (model.nq, model.nv, model.nu) == (9, 8, 2)
    assert model.joint("walker/root").type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert model.body("walker/trunk").parentid[0] == 0
    np.testing.assert_allclose(model.qpos0[:7], (*WALKER.pos, *WALKER.rot))


def test_a_bolted_root_has_none():
    model = model_of(fixed_base=True)
    assert (model.nq, model.nv) == (2, 2)


def test_masses_are_replaced_by_those_of_the_robot():
    model = model_of()
    trunk = model.body("walker/trunk")
    assert trunk.mass[0] == MASS_KG
    np.testing.assert_allclose(trunk.ipos, (0.0, 0.01, 0.02))
    np.testing.assert_allclose(sorted(trunk.inertia), (0.04, 0.05, 0.06))
    assert model.body("walker/left_leg").mass[0] == 1.0


def test_a_hull_replaces_what_is_touched_and_not_what_is_seen():
    corners = tuple((x, y, z) for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (0.0, 0.1))
    trunk = dataclasses.replace(WALKER.bodies[0], hull=corners)
    model = model_of(bodies=(trunk,))
    body = model.body("walker/trunk")
    geoms = [model.geom(int(body.geomadr[0]) + index) for index in range(int(body.geomnum[0]))]
    touched = [geom for geom in geoms if geom.contype[0]]
    assert [geom.type[0] for geom in touched] == [mujoco.mjtGeom.mjGEOM_MESH]
    assert len(geoms) == 2
    assert body.mass[0] == MASS_KG  # shapes add nothing to it


def test_unknown_bodies_are_refused():
    trunk = dataclasses.replace(WALKER.bodies[0], name="trunc")
    with pytest.raises(UnknownNameError, match=r"body of robot 'walker' 'trunc'.*Did you mean 'trunk'"):
        model_of(bodies=(trunk,))
    with pytest.raises(UnknownNameError, match=r"Unknown body of robot 'walker' 'lef_leg'"):
        model_of(sites=(SiteCfg(name="head", body="lef_leg", pos=(0.0, 0.0, 0.0)),))


def test_undeclared_joints_are_refused_and_passive_ones_are_not():
    """A reset would not restore the state of a joint that the robot does not declare."""
    left, right = WALKER.joints
    with pytest.raises(ConfigError, match=f"does not declare the joints {right.name} of its file"):
        model_of(joints=(left,))
    assert model_of(joints=(left, dataclasses.replace(right, driven=False))).nu == 1


def test_camera_that_does_not_turn_only_translates():
    camera = CameraCfg(
        name="beside", mount="walker/trunk", turns=False, pos=(0.0, 2.0, 1.0), look_at=(0.0, 0.0, 0.0)
    )
    model = build_model(dataclasses.replace(SCENARIO, cameras=(camera,)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    turned = data.cam_xmat[0].copy()
    data.qpos[:7] = (3.0, -1.0, 0.5, 0.6, 0.0, 0.8, 0.0)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.cam_xpos[0], (3.0, 1.0, 1.5), atol=1e-9)
    np.testing.assert_allclose(data.cam_xmat[0], turned, atol=1e-9)
