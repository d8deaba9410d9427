"""ManiSkill's delta actions: numbers, ManiSkill's own motions, and the expert by them."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from envs.scenario import ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.spec import EnvSpec
from envs.state import EntityState, State
from envs.tasks.arms import facing
from envs.tasks.delta_controllers import JointDeltaController, PoseDeltaController
from envs.tasks.pick_cube import PickCube

HZ = 20.0
SPACES = {"pd_joint_delta_pos": JointDeltaController, "pd_ee_delta_pose": PoseDeltaController}
REST = torch.tensor([FRANKA.default_qpos], dtype=torch.float64)


def test_a_joints_entry_of_one_is_a_tenth_of_a_radian_from_where_it_is():
    controller = JointDeltaController(FRANKA, HZ)
    assert controller.names == (*(f"joint{index}" for index in range(1, 8)), "gripper")
    action = np.array([[1.0, -1.0, 0.5, 0.0, 3.0, 0.0, -0.1, 1.0]])
    targets = controller.targets(REST, action)[0]
    moved = [0.1, -0.1, 0.05, 0.0, 0.1, 0.0, -0.01]
    np.testing.assert_allclose(targets[:7] - REST[0, :7], moved, atol=1e-9)
    np.testing.assert_allclose(targets[7:], 0.04, atol=1e-9)


@pytest.mark.parametrize(("gripper", "finger"), [(-1.0, 0.0), (-0.6, 0.0), (0.2, 0.02), (1.0, 0.04)])
def test_the_gripper_is_absolute(gripper, finger):
    for kind, size in ((JointDeltaController, 7), (PoseDeltaController, 6)):
        targets = kind(FRANKA, HZ).targets(REST, np.array([[0.0] * size + [gripper]]))
        np.testing.assert_allclose(targets[0, 7:], finger, atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_the_hand_moves_and_turns_about_the_axes_of_its_base(yaw):
    robot = facing(FRANKA, "turned", (0.2, 0.1, 0.0), yaw)
    controller = PoseDeltaController(robot, HZ)
    chain = controller._kinematics(torch.device("cpu")).chain
    start = chain(REST[:, chain.columns])

    def reached(*entries):
        targets = controller.targets(REST, np.array([[*entries, 1.0]]))
        return chain(targets[:, :7])

    ahead = torch.tensor([np.cos(yaw), np.sin(yaw), 0.0])
    moved = reached(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(moved.pos[0] - start.pos[0], 0.05 * ahead, atol=1e-3)
    # ManiSkill turns the other way round: an entry of 1 about z is -0.1 rad.
    turned = reached(0.0, 0.0, 0.0, 0.0, 0.0, 1.0).rot @ start.rot.transpose(1, 2)
    np.testing.assert_allclose(torch.atan2(turned[0, 1, 0], turned[0, 0, 0]), -0.1, atol=1e-3)
    # Three entries of 1 together are no longer than one.
    turned = reached(0.0, 0.0, 0.0, 1.0, 1.0, 1.0).rot @ start.rot.transpose(1, 2)
    angle = torch.arccos((turned.diagonal(dim1=1, dim2=2).sum() - 1.0) / 2.0)
    np.testing.assert_allclose(angle, 0.1, atol=3e-3)


@pytest.mark.parametrize("space", sorted(SPACES))
@pytest.mark.parametrize("name", ["franka", "ur5e"])
def test_a_step_of_an_ideal_servo_comes_to_where_it_is_sent(space, name):
    robot = ROBOTS.get(name)
    controller = SPACES[space](robot, HZ)
    rest = torch.tensor([robot.default_qpos], dtype=torch.float64)
    entity = EntityState.at_rest(np.array(robot.pos), np.array([robot.rot]), rest.numpy())
    wanted = rest[:, list(robot.driven)].clone()
    wanted[:, : len(robot.arm)] += torch.linspace(-0.01, 0.01, len(robot.arm))
    action = controller.towards(State({robot.name: entity}, {}), wanted)
    share = 1.0 - np.exp(-1.0 / (HZ * 0.1))
    ended = rest[:, : len(robot.arm)].clone()
    ended += share * (controller.targets(rest, action)[:, : len(robot.arm)] - ended)
    chain = controller._kinematics(torch.device("cpu")).chain
    reached, asked = chain(ended), chain(wanted[:, chain.columns])
    np.testing.assert_allclose(reached.pos, asked.pos, atol=5e-4)
    np.testing.assert_allclose(reached.rot, asked.rot, atol=3e-3)
    if space == "pd_joint_delta_pos":
        np.testing.assert_allclose(ended, wanted[:, : len(robot.arm)], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("space", sorted(SPACES))
def test_the_arm_moves_as_maniskills_does(space):
    """``maniskill_motion.json`` was recorded in ManiSkill: in 50 steps joints move by up to 0.8 rad."""
    motion = json.loads(Path(__file__).with_name("maniskill_motion.json").read_text())[space]
    joints, controller = np.array(motion["joints"]), SPACES[space](FRANKA, HZ)
    assert np.ptp(joints[:, :7], axis=0).max() > 0.4
    physics = PickCube().scenario.physics
    with MujocoHandler(ScenarioCfg(robots=(FRANKA,), physics=physics), 1, num_threads=1) as handler:
        handler.launch()
        state = handler.get_states()
        entity = state.robots["franka"]
        start = torch.from_numpy(joints[:1])
        entity.joint_pos, entity.joint_target = start.to(entity.joint_pos), start.to(entity.joint_pos)
        entity.joint_vel = torch.zeros_like(entity.joint_vel)
        handler.set_states(state)
        for action, expected in zip(motion["actions"], joints[1:], strict=True):
            for _ in range(motion["repeat"]):
                controller.advance(handler, np.array([action], np.float32), physics.decimation)
            now = handler.get_states().robots["franka"].joint_pos[0]
            np.testing.assert_allclose(now[:7], expected[:7], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("space", sorted(SPACES))
@pytest.mark.parametrize("task", ["PickCube", "PegInsertionSide"])
def test_the_expert_solves_tasks_by_maniskills_actions(task, space):
    env = EnvSpec(task=task, task_kwargs={"action_space": space}).make(2, observation="state")
    try:
        made = list(expert_episodes(env, env.split_indices[:2].tolist()))
        assert [episode.success for episode in made] == [True, True]
        assert np.abs(np.concatenate([episode.actions for episode in made])).max() <= 1.0
        assert (
            env.task.controller.hold(env.get_states())[:, :-1].tolist()
            == [[0.0] * (made[0].actions.shape[1] - 1)] * 2
        )
    finally:
        env.close()


def test_what_is_no_arm_with_a_hand_is_refused():
    with pytest.raises(ConfigError, match="has no action_space=pd_ee_delta_pose: it needs joint targets"):
        EnvSpec(task="control/cartpole", task_kwargs={"action_space": "pd_ee_delta_pose"}).make_task()
    with pytest.raises(ConfigError, match="action_space=pd_joint_delta_pos takes a task of one robot"):
        EnvSpec(task="TwoRobotPickCube", task_kwargs={"action_space": "pd_joint_delta_pos"}).make_task()
