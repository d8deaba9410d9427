"""What actions mean."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.controllers import (
    JointDeltaController,
    JointPositionController,
    NormalizedPositionController,
    PulledHandController,
)
from envs.handlers.mujoco.handler import MujocoHandler
from envs.robots.franka import FRANKA
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
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


def test_joint_deltas_start_where_the_joints_are_and_the_gripper_is_absolute(franka):
    controller = JointDeltaController(FRANKA, delta_rad=0.1)
    assert controller.names == (*FRANKA.joint_names[:7], "gripper")
    assert (controller.low == -1).all() and (controller.high == 1).all()
    before = franka.get_states().robots["franka"]
    action = torch.zeros(1, 8)
    action[0, 0], action[0, 1], action[0, 7] = 0.5, -7.0, -1.0  # what lies beyond 1 is clipped
    for _ in range(2):  # nothing adds up: an arm that presses is free of what it presses on in the next step
        controller.apply(franka, action, [1])
    after = franka.get_states().robots["franka"].joint_target
    expected = before.joint_pos[1].clone()
    expected[0] += 0.05
    expected[1] -= 0.1
    expected[7:] = 0.0
    torch.testing.assert_close(after[1], expected)
    assert torch.equal(after[0], before.joint_target[0])
    assert torch.equal(franka.get_joint_targets("franka", [1]), after[1:])
    assert torch.equal(franka.get_joint_positions("franka", [1]), before.joint_pos[1:])


def test_holding_by_joint_deltas_keeps_joints_where_they_are_and_the_gripper(franka):
    controller = JointDeltaController(FRANKA)
    actions = np.zeros((2, 8), np.float32)
    actions[:, 7] = [0.5, -0.25]
    controller.apply(franka, actions)
    before = franka.get_states()
    controller.apply(franka, controller.hold(before))
    after = franka.get_states().robots["franka"].joint_target
    torch.testing.assert_close(after[:, :7], before.robots["franka"].joint_pos[:, :7])
    torch.testing.assert_close(after[:, 7:], before.robots["franka"].joint_target[:, 7:])


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
