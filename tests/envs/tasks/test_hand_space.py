"""``task_kwargs.action_space=hand``: one policy's numbers mean the same for every arm."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.experts.actor import expert_episodes
from envs.hand_target_controller import NAMES, HandTargetController
from envs.rotations import to_matrix
from envs.spec import EnvSpec

HAND = {"action_space": "hand"}


def make(robot="", num_envs=2, **spec):
    return EnvSpec(task="PickCube", task_kwargs=HAND, robot=robot, **spec).make(num_envs, observation="state")


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["", "ur5e"])
def test_the_expert_solves_the_task_by_poses_of_the_hand(robot):
    env = make(robot)
    try:
        made = list(expert_episodes(env, env.split_indices[:2].tolist(), record=("states",)))
        assert [episode.success for episode in made] == [True, True]
        assert made[0].actions.shape[1] == len(NAMES)
        hand = env.task.proprioception(made[0].states)[1:]
        gap = np.linalg.norm(hand[:, :3].numpy() - made[0].actions[:, :3], axis=1)
        assert np.median(gap) < 0.02, "an action is where the hand is about to be, in the world"
    finally:
        env.close()


def test_joint_targets_and_their_hand_poses_mean_the_same():
    env = make()
    try:
        env.reset(seed=0)
        controller = env.controller
        assert isinstance(controller, HandTargetController)
        state = env.get_states()
        hold = controller.hold(state)
        (targets,) = controller.joint_targets(env.handler, hold).values()
        # The elbow, which the pose leaves open, moves a little towards rest.
        np.testing.assert_allclose(targets, state.robots["franka"].joint_target, atol=6e-3)
        moved = hold.copy()
        moved[:, 2] += 0.02
        (targets,) = controller.joint_targets(env.handler, moved).values()
        np.testing.assert_allclose(controller.of_joint_targets(np.asarray(targets)), moved, atol=2e-3)
    finally:
        env.close()


def test_the_state_is_the_pose_of_the_hand():
    env = make()
    try:
        observation, _ = env.reset(seed=0)
        robot = env.get_states().robots["franka"]
        state = torch.as_tensor(observation["observation.state"] if "observation.state" in observation
                                else observation["agent_pos"])  # fmt: skip
        assert state.shape == (2, len(NAMES)) and env.state_names == NAMES
        np.testing.assert_allclose(state[:, :3], robot.ee_pos, atol=1e-5)
        rot = to_matrix(torch.as_tensor(robot.ee_rot))
        np.testing.assert_allclose(state[:, 3:6], rot[:, :, 0], atol=1e-5)
        np.testing.assert_allclose(state[:, 9], 1.0, atol=0.02, err_msg="the hand begins open")
    finally:
        env.close()


def test_the_default_and_wrong_spaces():
    assert EnvSpec(task="PickCube", task_kwargs={"action_space": "joints"}).make_task().controller.names[
        0
    ] == ("joint1")
    with pytest.raises(UnknownNameError, match="joints"):
        EnvSpec(task="PickCube", task_kwargs={"action_space": "hands"}).make_task()
    with pytest.raises(
        ConfigError, match="action_space=hand: it needs joint targets of an arm with a gripper"
    ):
        EnvSpec(task="control/cartpole", task_kwargs=HAND).make_task()
