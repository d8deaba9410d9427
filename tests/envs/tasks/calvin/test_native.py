"""CALVIN's own actions and observations, against its robot code and its start state."""

import numpy as np
import pytest
import torch

from envs.kinematics.forward import KinematicChain
from envs.spec import EnvSpec
from envs.state import EntityState
from envs.tasks.calvin import native
from envs.tasks.calvin.scene import HOME, ROBOT
from envs.tasks.protocols import PROTOCOLS

# The first six numbers of robot_obs in CALVIN's get_env_state_for_initial_condition, and its joints' posture.
TCP_POS, TCP_EULER = (0.02586889, -0.2313129, 0.5712808), (3.09045411, -0.02908596, 1.50013585)


def home():
    return torch.tensor([HOME], dtype=torch.float64)


def test_the_hand_at_home_is_oriented_as_calvins_tcp_and_in_line_with_it():
    chain = KinematicChain(ROBOT)
    pose = chain(home()[:, chain.columns])
    np.testing.assert_allclose(native.euler_of(native.tcp_rotation(pose.rot))[0], TCP_EULER, atol=0.02)
    ahead = np.array(TCP_POS) - pose.pos[0].numpy()
    np.testing.assert_allclose(ahead, 0.045 * pose.rot[0, :, 2].numpy(), atol=0.004)  # its longer fingers


def test_euler_angles_and_matrices_are_inverses():
    euler = torch.tensor([TCP_EULER, (0.3, -1.2, 2.9)], dtype=torch.float64)
    torch.testing.assert_close(native.euler_of(native.matrix_of(euler)), euler)


@pytest.mark.parametrize("axis", range(6))
def test_an_action_of_one_moves_the_target_by_2_cm_or_an_euler_angle_by_a_twentieth(axis):
    controller = native.RelativeCartesianController(ROBOT)
    action = np.zeros((1, 7))
    action[0, axis], action[0, 6] = 1.0, 1.0
    targets = controller.moved_targets(home(), home(), action)
    before, after = controller.target_pose(home(), home()), controller.target_pose(home(), targets)
    moved = (after[0] - before[0])[0]
    euler = [native.euler_of(native.tcp_rotation(rot))[0] for _, rot in (before, after)]
    expected = torch.zeros(6, dtype=torch.float64)
    expected[axis] = 0.02 if axis < 3 else 0.05
    torch.testing.assert_close(moved, expected[:3], atol=2e-4, rtol=0)
    torch.testing.assert_close(euler[1] - euler[0], expected[3:], atol=1e-3, rtol=0)


def test_the_gripper_opens_with_1_and_closes_with_minus_1():
    controller = native.RelativeCartesianController(ROBOT)
    ends = [controller.moved_targets(home(), home(), np.eye(7)[6:] * sign)[0, -2:] for sign in (1.0, -1.0)]
    np.testing.assert_allclose(ends[0], 0.04)
    assert (ends[1] <= 0.0).all()


def test_robot_obs_has_calvins_15_numbers():
    state = EntityState.at_rest(np.array(ROBOT.pos), np.array([ROBOT.rot]), np.array([HOME]))
    state.joint_target = home()
    state.ee_pos, state.ee_rot = torch.zeros((1, 3)).double(), torch.tensor([[0.0, 1.0, 0.0, 0.0]]).double()
    obs = native.robot_obs(ROBOT, state)[0]
    assert len(obs) == 15 == len(native.STATE_NAMES) == len(native.STATE_LIMITS[0])
    assert obs[6] == pytest.approx(0.08) and obs[14] == 1.0
    np.testing.assert_allclose(obs[7:14], HOME[:7])
    state.joint_target[:, -2:] = 0.0
    assert native.robot_obs(ROBOT, state)[0, 14] == -1.0


@pytest.mark.slow
def test_the_expert_opens_the_drawer_with_calvins_actions():
    from envs.experts.actor import expert_episodes

    kwargs = {key: "native" for key in ("action_space", "observation_space")}
    env = EnvSpec(task="calvin/D/open_drawer", task_kwargs=kwargs).make(1, split="test", observation="state")
    try:
        (episode,) = expert_episodes(env, env.split_indices[:1].tolist())
        assert episode.success and episode.actions.shape[1] == 7
        assert np.abs(episode.actions).max() <= 1.0
        assert env.single_observation_space["agent_pos"].shape == (15,)
    finally:
        env.close()


def test_the_protocol_takes_calvins_interface_and_cameras():
    env = PROTOCOLS.get("calvin").env
    assert env["task_kwargs"]["action_space"] == "native" and env["cameras"] == ["static", "gripper"]
