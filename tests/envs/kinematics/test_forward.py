"""Batched kinematics against MuJoCo's own, and closed forms."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from envs.kinematics.forward import KinematicChain, from_rotation_vector, rotation_vector
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.robots.franka import FRANKA
from envs.scenario import ScenarioCfg

ROBOT = dataclasses.replace(FRANKA, pos=(0.3, -0.2, 0.1), rot=(0.8, 0.0, 0.0, 0.6))


@pytest.fixture(scope="module")
def chain():
    return KinematicChain(ROBOT)


@pytest.fixture(scope="module")
def simulated():
    """Position, orientation and Jacobian of the end effector by MuJoCo, for K joint positions."""
    scenario = ScenarioCfg(robots=(ROBOT,), table=None, room=None)
    model = build_model(scenario)
    layout = layout_of(model, scenario).robots[0]
    data = mujoco.MjData(model)

    def at(qpos):
        data.qpos[layout.qpos[:7]] = qpos
        mujoco.mj_forward(model, data)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, layout.ee_site)
        site = data.site(layout.ee_site)
        jacobian = np.concatenate([linear, angular])[:, layout.qvel[:7]]
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy(), jacobian

    return at


def postures(count):
    low, high = np.array([joint.range for joint in ROBOT.joints[:7]]).T
    return np.random.default_rng(0).uniform(low, high, (count, 7))


def test_the_arm_is_the_chain_and_the_fingers_are_not(chain):
    assert chain.columns == list(range(7))
    np.testing.assert_allclose(chain.low, [joint.range[0] for joint in ROBOT.joints[:7]])
    np.testing.assert_allclose(chain.high, [joint.range[1] for joint in ROBOT.joints[:7]])


def test_poses_and_jacobians_are_mujocos(chain, simulated):
    qpos = postures(20)
    poses = chain(torch.from_numpy(qpos))
    for row, posture in enumerate(qpos):
        pos, rot, jacobian = simulated(posture)
        np.testing.assert_allclose(poses.pos[row], pos, atol=1e-12)
        np.testing.assert_allclose(poses.rot[row], rot, atol=1e-12)
        np.testing.assert_allclose(poses.jacobian[row], jacobian, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, -2.0, 3.1])
def test_a_rotation_vector_is_axis_times_angle(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rot = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    np.testing.assert_allclose(rotation_vector(torch.from_numpy(rot)), angle * axis, atol=1e-9)
    np.testing.assert_allclose(from_rotation_vector(torch.from_numpy(angle * axis)[None])[0], rot, atol=1e-9)
