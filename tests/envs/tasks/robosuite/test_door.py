"""The door's numbers, by hand, and its latch."""

import mujoco
import numpy as np
import pytest
import torch

from envs.mjcf.model import build_model
from envs.tasks.robosuite.door import LATCH_RANGE_RAD, Door
from tests.envs.tasks.table_states import assert_fills, starts, vector

LOCKED, PLAIN = Door(), Door(latch=False)


def test_doors_start_in_robosuites_ranges():
    state = starts(LOCKED, 2000)
    door = state.objects["door"]
    assert_fills(door.pos[:, 0], -0.13, -0.11)
    assert_fills(door.pos[:, 1], -0.36, -0.34)
    assert (door.pos[:, 2] == 0.3).all()
    assert_fills(2 * torch.atan2(door.rot[:, 3], door.rot[:, 0]), -np.pi / 2 - 0.25, -np.pi / 2)
    assert (door.joint_pos == 0.0).all() and door.joint_pos.shape == (2000, 2)
    assert starts(PLAIN).objects["door"].joint_pos.shape == (1, 1)


@pytest.mark.parametrize("task", [LOCKED, PLAIN])
@pytest.mark.parametrize(("angle", "solved"), [(0.3001, True), (0.2999, False)])
def test_an_open_door_is_open_by_more_than_0_3_rad(task, angle, solved):
    state = starts(task)
    state.objects["door"].joint_pos[:, 0] = angle
    assert task.success(state).tolist() == [solved]


@pytest.mark.parametrize("task", [LOCKED, PLAIN])
@pytest.mark.parametrize("hinge", [0.0, 0.35])
@pytest.mark.parametrize("turn", [0.0, 1.2])
def test_the_handle_is_where_the_model_has_it(task, hinge, turn):
    """The site of robosuite's file, 5 cm from the bar's middle along the handle's x axis."""
    state = starts(task)
    door = state.objects["door"]
    joints = [hinge, turn] if task.latch else [hinge]
    door.joint_pos[:] = torch.tensor(joints)
    model = build_model(task.scenario)
    data = mujoco.MjData(model)
    body = model.body("door").mocapid[0]
    data.mocap_pos[body], data.mocap_quat[body] = door.pos[0].numpy(), door.rot[0].numpy()
    data.joint("door/hinge").qpos = hinge
    if task.latch:
        data.joint("door/latch").qpos = turn
    mujoco.mj_forward(model, data)
    latch = data.body("door/latch")
    site = latch.xpos + latch.xmat.reshape(3, 3) @ np.array([0.125, -0.1, 0.0])
    np.testing.assert_allclose(task._handle(state)[0], site, atol=1e-9)


def test_reward_by_hand():
    """0.25 (1 - tanh 10 d), and of a latched door 0.25 for a quarter turn of its handle."""
    state = starts(LOCKED)
    state.robots["franka"].ee_pos = LOCKED._handle(state) + vector(0.0, 0.0, 0.05)
    near = 0.25 * (1 - np.tanh(0.5))
    assert LOCKED.reward(state).item() == pytest.approx(near)
    state.objects["door"].joint_pos[:, 1] = -LATCH_RANGE_RAD / 2
    state.robots["franka"].ee_pos = LOCKED._handle(state) + vector(0.0, 0.0, 0.05)
    assert LOCKED.reward(state).item() == pytest.approx(near + 0.125)


@pytest.mark.parametrize(("turn", "opens"), [(0.0, False), (0.8, False), (1.25, True), (None, True)])
def test_the_latch_holds_the_door_until_its_handle_is_turned(turn, opens):
    """A torque of 3 N·m on the hinge for a second, with the handle held; ``None`` is the plain door."""
    model = build_model((PLAIN if turn is None else LOCKED).scenario)
    data = mujoco.MjData(model)
    hinge = model.joint("door/hinge")
    for _ in range(round(1.0 / model.opt.timestep)):
        data.qfrc_applied[hinge.dofadr] = 3.0
        if turn is not None:
            latch = model.joint("door/latch")
            data.qpos[latch.qposadr], data.qvel[latch.dofadr] = turn, 0.0
        mujoco.mj_step(model, data)
    angle = float(data.qpos[hinge.qposadr[0]])
    assert (angle > 0.3) == opens
    assert opens or angle < 0.1


def test_the_expert_presses_a_latched_handle_and_hooks_a_free_one():
    rng = np.random.default_rng(0)
    pressed = LOCKED.expert(starts(LOCKED), rng)
    assert min(way.pos[2] for way in pressed) < 0.3 - 0.025 - 0.08
    state = starts(LOCKED)
    state.objects["door"].joint_pos[:, 0] = 0.15
    hooked = LOCKED.expert(state, rng)
    assert all(way.roll == 0.0 for way in hooked)
    assert min(way.pos[2] for way in hooked) == pytest.approx(0.3 - 0.025, abs=1e-6)
