import numpy as np
import pytest
import torch

from envs.hand_pose_controller import HandPoseController
from envs.kinematics.forward import rotation_vector
from envs.robots.franka import FRANKA
from envs.scenario import ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState, State


@pytest.fixture
def franka():
    with MujocoHandler(ScenarioCfg(robots=(FRANKA,)), 2, num_threads=1) as handler:
        handler.launch()
        qpos = np.tile(np.array(FRANKA.default_qpos), (2, 1))
        at_rest = EntityState.at_rest(np.zeros(3), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), qpos)
        handler.set_states(State({"franka": at_rest}, {}))
        yield handler


def target_pose(handler, controller):
    robot = handler.get_states().robots["franka"]
    return controller.target_pose(robot.joint_pos, robot.joint_target)


def entries(*values):
    return np.array([values, (0.0,) * 6 + (1.0,)], np.float32)


@pytest.mark.parametrize("entry", range(6))
def test_an_action_moves_or_turns_the_target_about_one_axis(franka, entry):
    controller = HandPoseController(FRANKA, delta_m=0.02, delta_rad=0.1)
    assert controller.names == ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
    assert (controller.low == -1).all() and (controller.high == 1).all()
    pos, rot = target_pose(franka, controller)
    values = np.zeros(7)
    values[entry], values[6] = 0.5, 1.0
    controller.apply(franka, entries(*values))
    moved, turned = target_pose(franka, controller)
    way, turn = np.zeros(3), np.zeros(3)
    (way if entry < 3 else turn)[entry % 3] = 0.01 if entry < 3 else 0.05
    np.testing.assert_allclose((moved - pos)[0], way, atol=5e-4)
    np.testing.assert_allclose(rotation_vector(turned @ rot.transpose(1, 2))[0], turn, atol=2e-3)
    torch.testing.assert_close(moved[1], pos[1], atol=1e-12, rtol=0.0)


def test_deltas_add_up_whatever_the_arm_has_done_meanwhile(franka):
    controller = HandPoseController(FRANKA)
    pos, _ = target_pose(franka, controller)
    action = entries(0.2, 0.0, -0.2, 0.0, 0.0, 0.0, 1.0)
    for _ in range(8):
        controller.advance(franka, action, 25)
    moved, _ = target_pose(franka, controller)
    np.testing.assert_allclose((moved - pos)[0], [0.08, 0.0, -0.08], atol=2e-3)


def test_an_action_of_zeros_leaves_every_target_as_it_is(franka):
    controller = HandPoseController(FRANKA)
    controller.advance(franka, entries(0.3, 0.1, -0.2, 0.2, 0.0, 0.3, 0.2), 25)
    before = franka.get_joint_targets("franka")
    for _ in range(20):
        controller.advance(franka, controller.hold(franka.get_states()), 25)
    torch.testing.assert_close(franka.get_joint_targets("franka"), before, atol=1e-7, rtol=0.0)


def test_targets_lead_a_blocked_arm_by_no_more_than_the_lead(franka):
    controller = HandPoseController(FRANKA, lead_rad=0.1)
    for _ in range(20):  # nothing steps, as if something held the arm
        controller.apply(franka, entries(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    robot = franka.get_states().robots["franka"]
    lead = (robot.joint_target - robot.joint_pos)[0, :7].abs()
    assert float(lead.max()) == pytest.approx(0.1, abs=1e-6)
    controller.apply(franka, entries(-0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    back = (franka.get_joint_targets("franka") - robot.joint_pos)[0, :7].abs()
    assert float(back.max()) < 0.09


@pytest.mark.parametrize(("entry", "finger_m"), [(1.0, 0.04), (-0.6, 0.0), (-1.0, 0.0), (0.2, 0.02)])
def test_the_gripper_is_absolute_and_its_entry_is_read_back(franka, entry, finger_m):
    controller = HandPoseController(FRANKA)
    state = franka.get_states()
    targets = torch.from_numpy(controller.as_task_actions(state, entries(0, 0, 0, 0, 0, 0, entry)))
    torch.testing.assert_close(targets[0, 7:], torch.tensor([finger_m] * 2).double(), atol=1e-6, rtol=0.0)
    assert float(controller.gripper_entry(targets)[0]) == pytest.approx(max(entry, -0.6), abs=1e-5)


def test_actions_of_the_task_are_those_that_the_controller_applies(franka):
    controller = HandPoseController(FRANKA)
    action = entries(0.3, -0.2, 0.1, 0.2, -0.1, 0.4, -1.0)
    targets = controller.as_task_actions(franka.get_states(), action)
    controller.apply(franka, action)
    np.testing.assert_allclose(franka.get_joint_targets("franka"), targets, atol=1e-7)
    from_here = controller.targets(franka.get_states().robots["franka"].joint_pos, action)
    np.testing.assert_allclose(from_here, targets, atol=1e-7)  # at rest, targets are where joints are
