"""What actions mean."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.controllers import (
    HandDeltaController,
    JointPositionController,
    NormalizedPositionController,
    PulledHandController,
)
from envs.kinematics.forward import KinematicChain, rotation_vector
from envs.robots.franka import FRANKA
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState
from tests.contracts.walker import SCENARIO

ROT = (0.5**0.5, 0.0, 0.5**0.5, 0.0)


@pytest.fixture(scope="module")
def franka():
    with MujocoHandler(ScenarioCfg(robots=(FRANKA,)), 2, num_threads=1) as handler:
        handler.launch()
        yield handler


@pytest.fixture(scope="module")
def sawyer():
    pytest.importorskip("metaworld")
    from envs.robots.sawyer import SAWYER

    ball = (GeomCfg(shape="sphere", size=(0.01,), visible=False),)
    target = ObjectCfg(name="target", geoms=ball, kind="marker", pulls="sawyer/hand")
    with MujocoHandler(ScenarioCfg(robots=(SAWYER,), objects=(target,)), 3, num_threads=1) as handler:
        handler.launch()
        yield handler


def hand_controller(handler):
    low, high = (-0.5, 0.4, 0.05), (0.5, 1.0, 0.5)
    return PulledHandController(
        handler.scenario.robots[0], "target", low=low, high=high, step_m=0.01, rot=ROT
    )


def place(handler, pos):
    state = handler.get_states()
    count = state.num_envs
    state.objects["target"] = EntityState.at_rest(np.tile(pos, (count, 1)), np.tile(ROT, (count, 1)))
    handler.set_states(state)


def test_joint_positions_are_targets_and_holding_is_staying(franka):
    controller = JointPositionController(FRANKA)
    assert controller.names == FRANKA.joint_names
    state = franka.get_states()
    actions = controller.hold(state) + 0.01
    controller.apply(franka, actions[1:], [1])
    targets = franka.get_states().robots["franka"].joint_target
    np.testing.assert_allclose(targets[1, :7], actions[1, :7])
    np.testing.assert_allclose(targets[0], state.robots["franka"].joint_target[0])


def settled(handler, controller, actions, steps):
    """Takes control steps of 50 ms from rest; returns where the end effectors were and are."""
    rest = handler.get_states()
    qpos = np.tile(FRANKA.default_qpos, (2, 1))
    rest.robots["franka"] = EntityState.at_rest(FRANKA.pos, np.tile(FRANKA.rot, (2, 1)), qpos)
    handler.set_states(rest)
    before = handler.get_states().robots["franka"]
    for _ in range(steps):
        controller.advance(handler, actions, 25)
    return before, handler.get_states().robots["franka"]


def test_an_action_puts_the_hands_target_from_where_the_hand_is(franka):
    controller = HandDeltaController(FRANKA, delta_m=0.02, delta_rad=0.2)
    assert controller.names == ("x", "y", "z", "yaw", "gripper")
    assert (controller.low == -1).all() and (controller.high == 1).all()
    state = franka.get_states()
    actions = np.array([[1.0, -0.5, 9.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0, 1.0]], np.float32)  # 9 is clipped
    targets = torch.from_numpy(controller.as_task_actions(state, actions))
    chain = KinematicChain(FRANKA)
    now = chain(state.robots["franka"].joint_pos[:, chain.columns])
    then = chain(targets[:, chain.columns])
    way = torch.tensor([[0.02, -0.01, 0.02], [0.0, 0.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(then.pos - now.pos, way, atol=2e-3, rtol=0.0)
    turn = rotation_vector(then.rot @ now.rot.transpose(1, 2))
    angles = torch.tensor([[0.0, 0.0, 0.2], [0.0, 0.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(turn, angles, atol=0.02, rtol=0.0)
    torch.testing.assert_close(targets[:, 7:], torch.tensor([[0.0, 0.0], [0.04, 0.04]]).double())


def test_nothing_adds_up_and_other_environments_are_left_alone(franka):
    controller = HandDeltaController(FRANKA)
    before = franka.get_states().robots["franka"]
    action = np.array([[0.0, 0.0, -1.0, 0.0, 0.0]])
    controller.apply(franka, action, [1])
    first = franka.get_states().robots["franka"].joint_target
    controller.apply(franka, action, [1])
    assert torch.equal(franka.get_joint_targets("franka", [1]), first[1:])
    assert torch.equal(first[0], before.joint_target[0])
    assert torch.equal(franka.get_joint_positions("franka"), before.joint_pos)


@pytest.mark.slow
@pytest.mark.parametrize("entry", range(3))
def test_the_hand_moves_along_one_axis_and_stays_upright(franka, entry):
    controller = HandDeltaController(FRANKA, delta_m=0.05)
    actions = np.zeros((2, 5))
    actions[:, entry] = 1.0, -1.0
    before, after = settled(franka, controller, actions, 10)
    way = (after.ee_pos - before.ee_pos).numpy()
    assert way[0, entry] > 0.05 and way[1, entry] < -0.05
    assert np.abs(np.delete(way, entry, axis=1)).max() < 0.1 * np.abs(way[:, entry]).min()
    assert (after.ee_rot * before.ee_rot).sum(-1).abs().min() > np.cos(np.deg2rad(5) / 2)


def test_a_tilted_hand_is_put_upright(franka):
    controller = HandDeltaController(FRANKA)
    tilted = torch.tensor([FRANKA.default_qpos] * 2, dtype=torch.float64)
    tilted[0, 5] += 0.3
    tilted[1, 4] -= 0.3
    state = franka.get_states()
    state.robots["franka"].joint_pos = tilted
    targets = torch.from_numpy(controller.as_task_actions(state, np.zeros((2, 5))))
    chain = KinematicChain(FRANKA)
    approach = chain(targets[:, chain.columns]).rot[:, :, 2]
    assert approach[:, 2].max() < -np.cos(np.deg2rad(3))
    assert torch.equal(state.robots["franka"].joint_pos, tilted)


def test_holding_by_the_hand_stays_and_keeps_the_gripper(franka):
    controller = HandDeltaController(FRANKA)
    before, _ = settled(franka, controller, np.array([[0.0] * 4 + [0.5], [0.0] * 4 + [-0.25]]), 1)
    actions = controller.hold(franka.get_states())
    np.testing.assert_allclose(actions, [[0.0] * 4 + [0.5], [0.0] * 4 + [-0.25]], atol=1e-6)
    _, after = settled(franka, controller, actions, 20)
    torch.testing.assert_close(after.ee_pos, before.ee_pos, atol=2e-3, rtol=0.0)


def test_an_action_of_one_moves_the_hand_by_a_step(sawyer):
    controller = hand_controller(sawyer)
    assert controller.names == ("x", "y", "z", "gripper")
    place(sawyer, (0.0, 0.6, 0.2))
    actions = np.array([[1.0, -0.5, 0.0, 1.0], [9.0, 0.0, -9.0, -2.0]], np.float32)
    controller.apply(sawyer, actions, [0, 2])
    state = sawyer.get_states()
    expected = [[0.01, 0.595, 0.2], [0.0, 0.6, 0.2], [0.01, 0.6, 0.19]]
    np.testing.assert_allclose(state.objects["target"].pos, expected, atol=1e-9)
    np.testing.assert_allclose(state.objects["target"].rot, [ROT] * 3)
    fingers = state.robots["sawyer"].joint_target[[0, 2]]
    torch.testing.assert_close(fingers, torch.tensor([[1.0, -1.0], [-1.0, 1.0]], dtype=torch.float64))


def test_the_hands_target_stays_within_its_bounds(sawyer):
    controller = hand_controller(sawyer)
    place(sawyer, (0.499, 0.4, 0.05))
    controller.apply(sawyer, np.array([[1.0, -1.0, -1.0, 0.0]] * 3, np.float32))
    np.testing.assert_allclose(sawyer.get_states().objects["target"].pos, [[0.5, 0.4, 0.05]] * 3)


def test_holding_keeps_the_hand_and_the_fingers(sawyer):
    controller = hand_controller(sawyer)
    place(sawyer, (0.0, 0.6, 0.2))
    controller.apply(sawyer, np.array([[0.0, 0.0, 0.0, 0.4]] * 3, np.float32))
    before = sawyer.get_states()
    actions = controller.hold(before)
    np.testing.assert_allclose(actions, [[0.0, 0.0, 0.0, 0.4]] * 3, atol=1e-6)
    controller.apply(sawyer, actions)
    after = sawyer.get_states()
    assert torch.equal(after.objects["target"].pos, before.objects["target"].pos)
    assert torch.equal(after.robots["sawyer"].joint_target, before.robots["sawyer"].joint_target)


def test_normalized_positions_cover_the_range_of_the_targets():
    scenario = dataclasses.replace(SCENARIO, cameras=())
    controller = NormalizedPositionController(scenario.robots[0])
    assert controller.names == ("right", "left")
    with MujocoHandler(scenario, 3, num_threads=1) as handler:
        handler.launch()
        controller.apply(handler, np.array([[-1.0, 1.0], [0.0, 0.0], [-7.0, 7.0]]))
        state = handler.get_states()
        expected = [[-0.8, 0.6], [-0.1, -0.1], [-0.8, 0.6]]
        np.testing.assert_allclose(state.robots["walker"].joint_target, expected, atol=1e-12)
        controller.apply(handler, torch.tensor([[0.5, -0.5]]), [1])
        held = controller.hold(handler.get_states())
        np.testing.assert_allclose(held, [[-1.0, 1.0], [0.5, -0.5], [-1.0, 1.0]], atol=1e-6)
