"""Momentum and energy against formulas, and against MuJoCo's own sums over a tree of bodies."""

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.mjcf.model import build_model
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg
from envs.state import EntityState
from roboverse_learn.sim2sim.conservation.experiments import CHAIN, scene, start_of
from roboverse_learn.sim2sim.conservation.mechanics import conserved, principal_inertia

ORIGIN = (0.0, 0.0, 0.0)


def ball(pos=(0.0, 0.0, 0.0)):
    return ObjectCfg(name="ball", geoms=(GeomCfg(shape="sphere", size=(0.5,), mass_kg=2.0, pos=pos),))


def moving(pos=(0.0, 0.0, 0.0), lin_vel=(0.0, 0.0, 0.0), ang_vel=(0.0, 0.0, 0.0), joints=(), speeds=()):
    state = EntityState.at_rest(np.array([pos]), np.array([1.0, 0.0, 0.0, 0.0]), np.array([joints]))
    state.lin_vel[:] = torch.tensor(lin_vel)
    state.ang_vel[:] = torch.tensor(ang_vel)
    state.joint_vel[:] = torch.tensor(speeds)
    return state


def test_flying_ball():
    state = moving(pos=(0.0, 3.0, 0.0), lin_vel=(4.0, 0.0, 0.0), ang_vel=(0.0, 0.0, 10.0))
    found = conserved((ball(),), {"ball": state}, ORIGIN)
    np.testing.assert_allclose(found.momentum, [[8.0, 0.0, 0.0]])
    inertia = 0.4 * 2.0 * 0.25
    np.testing.assert_allclose(found.angular_momentum, [[0.0, 0.0, -24.0 + inertia * 10.0]])
    np.testing.assert_allclose(found.kinetic_energy, [16.0 + 0.5 * inertia * 100.0])


def test_offset_mass_moves_with_the_rotation_of_its_root():
    found = conserved((ball(pos=(2.0, 0.0, 0.0)),), {"ball": moving(ang_vel=(0.0, 0.0, 3.0))}, ORIGIN)
    np.testing.assert_allclose(found.momentum, [[0.0, 12.0, 0.0]])
    np.testing.assert_allclose(found.angular_momentum, [[0.0, 0.0, 24.0 + 0.2 * 3.0]])


def test_moments_of_inertia_of_a_box():
    box = GeomCfg(shape="box", size=(0.5, 1.0, 1.5), mass_kg=12.0)  # sides 1, 2, 3
    np.testing.assert_allclose(principal_inertia(box), [4.0 + 9.0, 1.0 + 9.0, 1.0 + 4.0])


def test_other_shapes_are_refused():
    with pytest.raises(ConfigError, match="inertia of a capsule is not known here; take a box or a sphere"):
        principal_inertia(GeomCfg(shape="capsule", size=(0.1, 0.2), mass_kg=1.0))


def test_slide_joint_carries_its_mass():
    slide = ObjectJointCfg(kind="slide", axis=(1.0, 0.0, 0.0), range=(0.0, 5.0))
    load = GeomCfg(shape="sphere", size=(0.5,), mass_kg=2.0)
    light = GeomCfg(shape="sphere", size=(0.5,), mass_kg=1e-12)
    item = ObjectCfg(name="ball", geoms=(light,), links=(LinkCfg(name="load", geoms=(load,), joint=slide),))
    state = moving(ang_vel=(0.0, 0.0, 3.0), joints=(2.0,), speeds=(5.0,))
    found = conserved((item,), {"ball": state}, ORIGIN)
    np.testing.assert_allclose(found.momentum, [[10.0, 12.0, 0.0]], atol=1e-9)


def test_chain_agrees_with_mujoco():
    """At random positions and speeds; MuJoCo sums over the tree of bodies."""
    model = build_model(scene(CHAIN, 0.005))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qpos[:] = rng.normal(size=model.nq)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    body = model.body("chain").id
    centre, mass = data.subtree_com[body], model.body_subtreemass[body]
    state = start_of(CHAIN).objects["chain"]
    state.pos[:], state.rot[:] = torch.from_numpy(data.qpos[None, :3]), torch.from_numpy(data.qpos[None, 3:7])
    state.lin_vel[:], state.ang_vel[:] = (torch.from_numpy(data.qvel[None, i : i + 3].copy()) for i in (0, 3))
    state.joint_pos[:], state.joint_vel[:] = (
        torch.from_numpy(part[None].copy()) for part in (data.qpos[7:], data.qvel[6:])
    )
    found = conserved(CHAIN.objects, {"chain": state}, centre)
    np.testing.assert_allclose(found.momentum[0], mass * data.subtree_linvel[body], atol=1e-12)
    np.testing.assert_allclose(found.angular_momentum[0], data.subtree_angmom[body], atol=1e-12)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    np.testing.assert_allclose(found.kinetic_energy[0], 0.5 * data.qvel @ inertia @ data.qvel)
