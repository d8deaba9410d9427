import numpy as np
import pytest
import torch

from envs.core.errors import DatasetError
from envs.rotations import multiply
from envs.tasks import TASKS
from roboverse_learn.data.importers.retarget import ARMS, Poses, Retargeter, opening, set_fingers, tool_path

ROBOT = TASKS.get("PickCube")().scenario.robots[0]


@pytest.fixture(scope="module")
def retargeter():
    return Retargeter(ROBOT)


def tool_poses(env, joint_pos):
    """Where the env's robot has its hand."""
    pos, rot = [], []
    state = env.get_states([0])
    for row in joint_pos:
        state.robots["franka"].joint_pos[:] = torch.from_numpy(row)
        env.handler.set_states(state, [0])
        robot = env.get_states([0]).robots["franka"]
        pos.append(robot.ee_pos[0].numpy())
        rot.append(robot.ee_rot[0].numpy())
    return Poses(np.array(pos), np.array(rot))


def test_a_path_of_our_own_hand_is_followed(retargeter, pick_env):
    steps = np.linspace(0.0, 1.0, 15)[:, None]
    away = np.array([0.8, 0.3, -0.5, 0.4, 0.6, 0.5, -0.9, 0, 0])
    path = tool_poses(pick_env, np.array(ROBOT.default_qpos) + steps * away)
    done = retargeter.follow(path)
    assert done.max_error_m < 1e-3 and done.max_error_rad < 0.01
    reached = tool_poses(pick_env, done.joint_pos)
    np.testing.assert_allclose(reached.pos, path.pos, atol=1e-3)
    np.testing.assert_allclose(np.abs((reached.rot * path.rot).sum(1)), 1.0, atol=1e-4)
    low, high = np.array([joint.range for joint in ROBOT.joints]).T
    assert (done.joint_pos >= low - 1e-6).all() and (done.joint_pos <= high + 1e-6).all()
    assert np.abs(np.diff(done.joint_pos, axis=0)).max() < 0.3


def test_the_same_path_gives_the_same_joints(retargeter, pick_env):
    path = tool_poses(pick_env, np.add(ROBOT.default_qpos, [[0.0], [0.01], [0.02]]))
    first = retargeter.follow(path).joint_pos
    np.testing.assert_array_equal(retargeter.follow(path).joint_pos, first)


@pytest.mark.slow
def test_a_path_out_of_reach_is_refused(retargeter):
    far = Poses(np.array([[3.0, 0.0, 0.3]]), np.array([[0.0, 1.0, 0.0, 0.0]]))
    with pytest.raises(DatasetError, match=r"cannot follow its path: at moment 0 it misses .* \d+ mm"):
        retargeter.follow(far)


def test_the_sawyer_has_its_makers_lengths():
    """With all joints at zero its links lie along x; their lengths are those of robosuite's file."""
    arm = ARMS["sawyer"]
    path = tool_path(arm, {name: np.zeros(1) for name in arm.joints})
    # Shoulder to hand: 81 + 400 + 400 + 134 mm; sideways 192.5 - 168.5 + 136.3 mm; up 80 + 237 mm.
    np.testing.assert_allclose(path.pos[0], [1.015 + arm.tool_m, 0.1603, 0.317], atol=1e-4)


def test_an_arms_first_joint_turns_its_tool_about_its_base():
    arm = ARMS["sawyer"]
    joints = {name: np.zeros(2) for name in arm.joints} | {"right_j0": np.array([0.0, 0.7])}
    path = tool_path(arm, joints)
    cosine, sine = np.cos(0.7), np.sin(0.7)
    x, y, z = path.pos[0]
    np.testing.assert_allclose(path.pos[1], [x * cosine - y * sine, x * sine + y * cosine, z], atol=1e-9)
    turn = np.array([np.cos(0.35), 0, 0, np.sin(0.35)])
    np.testing.assert_allclose(np.abs(multiply(turn, path.rot[0]) @ path.rot[1]), 1.0, atol=1e-9)
    with pytest.raises(DatasetError, match="lacks the joints right_j3"):
        tool_path(arm, {name: values for name, values in joints.items() if name != "right_j3"})


def test_grippers_open_by_the_same_share():
    arm = ARMS["sawyer"]
    left, right = arm.fingers
    opened = np.array([0.0026, 0.0116, 0.0206, 0.03])
    fingers = {left: opened, right: -opened}
    share = opening(arm, fingers)
    np.testing.assert_allclose(share, [0.0, 0.5, 1.0, 1.0], atol=1e-9)
    joint_pos = np.zeros((4, 9))
    set_fingers(ROBOT, joint_pos, share)
    np.testing.assert_allclose(joint_pos[:, 7:], share[:, None] * [0.04, 0.04], atol=1e-9)
    assert not joint_pos[:, :7].any()
    with pytest.raises(DatasetError, match="Its gripper lacks the joints"):
        opening(arm, {})
