"""Forward kinematics of robots with a free base, against MuJoCo's."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.kinematics.body_poses import BodyTree
from envs.simulators.mujoco.handler import MujocoHandler
from tests.contracts.walker import SCENARIO, WALKER, random_states

COUNT = 4


def test_bodies_are_where_mujoco_has_them_and_move_as_it_says():
    states = random_states(0, COUNT)
    with MujocoHandler(SCENARIO, 1, num_threads=1) as handler:
        handler.launch()
        model, layout = handler.model, handler.layout.robots[0]
    tree = BodyTree(WALKER)
    bodies = tree(states.robots["walker"])
    com_vel = tree.com_velocity(bodies)
    data = mujoco.MjData(model)
    for row in range(COUNT):
        robot = states.select([row]).robots["walker"]
        data.qpos[:7] = torch.cat([robot.pos, robot.rot], -1)[0].numpy()
        data.qvel[:6] = torch.cat([robot.lin_vel, robot.ang_vel], -1)[0].numpy()
        data.qpos[layout.qpos], data.qvel[layout.qvel] = (
            robot.joint_pos[0].numpy(),
            robot.joint_vel[0].numpy(),
        )
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        for index, name in enumerate(tree.names):
            body = model.body(f"walker/{name}").id
            np.testing.assert_allclose(bodies.pos[row, index], data.xpos[body], atol=1e-12)
            np.testing.assert_allclose(bodies.rot[row, index].ravel(), data.xmat[body], atol=1e-12)
            speed = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, speed, 0)
            np.testing.assert_allclose(bodies.ang_vel[row, index], speed[:3], atol=1e-12)
            np.testing.assert_allclose(bodies.lin_vel[row, index], speed[3:], atol=1e-12)
        root = model.body("walker/trunk").id
        np.testing.assert_allclose(com_vel[row], data.subtree_linvel[root], atol=1e-12)
        np.testing.assert_allclose(
            tree.place(bodies, 0, (0.0, 0.0, 0.2))[row], data.site("walker/head").xpos, atol=1e-12
        )


def test_single_precision_is_enough_for_a_reward():
    states = random_states(1, COUNT)
    double = BodyTree(WALKER)
    single = BodyTree(WALKER, dtype=torch.float32)
    exact = double.com_velocity(double(states.robots["walker"]))
    rounded = single.com_velocity(single(states.to("cpu", torch.float32).robots["walker"]))
    assert rounded.dtype == torch.float32
    np.testing.assert_allclose(rounded, exact, atol=1e-5)


def test_the_root_comes_first_and_names_are_the_robots_own():
    tree = BodyTree(WALKER)
    assert set(tree.names) == {"trunk", "left_leg", "right_leg"}
    assert tree.index("trunk") == 0
    assert tree.masses.sum() == 7.0
    with pytest.raises(UnknownNameError, match=r"Unknown body 'left_lag'.*Did you mean 'left_leg'"):
        tree.index("left_lag")


def test_other_joints_are_refused(tmp_path):
    text = (SCENARIO.robots[0].mjcf, "tests")[0]
    for old, new, said in (
        ('name="left" axis', 'name="left" type="slide" axis', "needs one hinge, or no joint"),
        ('name="left" axis', 'name="left" pos="0 0 0.1" axis', "is not at its origin"),
    ):
        path = tmp_path / "other.xml"
        with open(text) as file:
            path.write_text(file.read().replace(old, new))
        with pytest.raises(ConfigError, match=said):
            BodyTree(dataclasses.replace(WALKER, mjcf=str(path)))
