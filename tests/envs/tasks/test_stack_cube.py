"""StackCube's numbers, by hand."""

import numpy as np
import pytest
import torch

from envs.core.errors import UnknownNameError
from envs.tasks.stack_cube import StackCube, _clear_yaw

TASK = StackCube()


def states(count=1):
    return TASK.initial_state([np.random.default_rng(i) for i in range(count)])


def stacked(dx=0.0, dy=0.0, dz=0.04):
    """The red cube at rest at an offset from the green one, an open hand 10 cm above it."""
    state = states()
    a, b, robot = state.objects["cube_a"], state.objects["cube_b"], state.robots["franka"]
    a.pos[:] = b.pos + torch.tensor([dx, dy, dz], dtype=torch.float64)
    robot.ee_pos = a.pos + torch.tensor([0.0, 0.0, 0.1], dtype=torch.float64)
    robot.ee_rot = torch.tensor([[0.0, 1.0, 1.0, 0.0]], dtype=torch.float64) / np.sqrt(2)  # down, turn 0
    robot.joint_target = robot.joint_pos.clone()
    return state


def in_hand(state, finger=0.02, target=0.0):
    """Puts the hand round the red cube."""
    robot = state.robots["franka"]
    robot.ee_pos = state.objects["cube_a"].pos.clone()
    robot.joint_pos[:, 7:] = finger
    if robot.joint_target is not None:
        robot.joint_target[:, 7:] = target
    return state


def test_initial_states_fill_maniskills_ranges():
    state = states(4000)
    a, b = state.objects["cube_a"].pos, state.objects["cube_b"].pos
    for axis, most in ((0, 0.2), (1, 0.3)):  # the common offset, 0.1, and each cube's own place
        assert a[:, axis].abs().max() <= most
        assert b[:, axis].abs().max() <= most
        assert a[:, axis].abs().max() > 0.9 * most
    # A sum of two uniform samples: variances add.
    assert a[:, 0].std().item() == pytest.approx(np.sqrt((0.1**2 + 0.1**2) / 3), rel=0.05)
    assert a[:, 1].std().item() == pytest.approx(np.sqrt((0.1**2 + 0.2**2) / 3), rel=0.05)
    assert (a[:, 2] == 0.02).all()
    assert (b[:, 2] == 0.02).all()
    arm = state.robots["franka"].joint_pos[:, :7] - torch.tensor(TASK.scenario.robots[0].default_qpos[:7])
    assert arm.std().item() == pytest.approx(0.02, rel=0.05)


def test_cubes_start_apart():
    """Farther apart than two diagonals, 2 (√2 · 0.02 + 0.001), they cannot touch, whatever their yaw."""
    state = states(4000)
    between = state.objects["cube_a"].pos - state.objects["cube_b"].pos
    gap = torch.linalg.vector_norm(between, dim=-1)
    assert 0.05856 < gap.min() < 0.063
    # Differences of places stay in the box twice theirs: the offset is common to both.
    assert between[:, 0].abs().max() <= 0.2
    assert between[:, 1].abs().max() <= 0.4


@pytest.mark.parametrize(
    ("offset", "solved"),
    [
        ((0.0, 0.0, 0.04), True),
        ((0.03328, 0.0, 0.04), True),  # √2 · 0.02 + 0.005 = 0.033284
        ((0.03329, 0.0, 0.04), False),
        ((0.0235, 0.0235, 0.04), True),  # 0.033234
        ((0.0236, 0.0236, 0.04), False),  # 0.033375
        ((0.0, 0.0, 0.0449), True),
        ((0.0, 0.0, 0.0451), False),
        ((0.0, 0.0, 0.0351), True),
        ((0.0, 0.0, 0.0349), False),
    ],
)
def test_success_is_on_top(offset, solved):
    assert TASK.success(stacked(*offset)).tolist() == [solved]


@pytest.mark.parametrize(
    ("linear", "angular", "solved"),
    [(0.0099, 0.0, True), (0.0101, 0.0, False), (0.0, 0.49, True), (0.0, 0.51, False)],
)
def test_success_is_still(linear, angular, solved):
    state = stacked()
    state.objects["cube_a"].lin_vel[:, 1] = linear
    state.objects["cube_a"].ang_vel[:, 2] = angular
    assert TASK.success(state).tolist() == [solved]


@pytest.mark.parametrize(
    ("finger", "target", "solved"),
    [
        (0.02, 0.0, False),  # closed on the cube
        (0.02, 0.0199, True),  # touching it, and no longer pressing
        (0.02, 0.04, True),  # about to open
        (0.04, 0.0, True),  # about to close
        (0.0291, 0.0, False),  # on its diagonal, 0.0566 and a margin
        (0.0294, 0.0, True),
        (0.0, 0.0, True),  # closed on nothing
    ],
)
def test_success_is_let_go(finger, target, solved):
    assert TASK.success(in_hand(stacked(), finger, target)).tolist() == [solved]


@pytest.mark.parametrize(("finger", "solved"), [(0.02, False), (0.035, True)])
def test_recordings_without_targets_are_judged_by_the_gap(finger, solved):
    state = stacked()
    state.robots["franka"].joint_target = None
    assert TASK.success(in_hand(state, finger)).tolist() == [solved]


@pytest.mark.parametrize("field", ["pos", "lin_vel", "ang_vel"])
def test_a_cube_that_is_not_finite_is_no_success(field):
    for value in (torch.nan, torch.inf):
        state = stacked()
        getattr(state.objects["cube_a"], field)[:, 2] = value
        assert not TASK.success(state).any()


def test_a_robot_that_is_not_finite_is_no_success():
    state = stacked()
    state.robots["franka"].joint_pos[:] = torch.nan
    state.robots["franka"].ee_pos[:] = torch.nan
    assert not TASK.success(state).any()


@pytest.mark.parametrize(
    ("offset", "solved"),
    [((0.0199, -0.0199, 0.0599), True), ((0.0201, 0.0, 0.04), False), ((0.0, 0.0, 0.0199), False)],
)
def test_the_papers_variant_is_a_box_and_does_not_ask_to_let_go(offset, solved):
    state = in_hand(stacked(*offset))
    state.objects["cube_a"].lin_vel[:] = 1.0
    assert StackCube(variant="roboverse").success(state).tolist() == [solved]


def test_a_wrong_variant_is_named():
    with pytest.raises(UnknownNameError, match="Did you mean 'roboverse'"):
        StackCube(variant="robovers")


def test_reward_by_hand():
    """ManiSkill's: 2 (1 - tanh 5d), 4 + near when grasped, 6 + (open + still) / 2 on top; over 8."""
    state = stacked(dx=0.3, dz=0.0)
    expected = 2 * (1 - np.tanh(0.5)) / 8
    assert TASK.reward(state).item() == pytest.approx(expected)
    expected = (4 + 1 - np.tanh(5 * 0.5)) / 8  # 0.3 and 0.4 away: 0.5
    assert TASK.reward(in_hand(stacked(dx=0.3, dz=-0.36))).item() == pytest.approx(expected)
    expected = (6 + (0.5 + 1 - np.tanh(10 * 0.02)) / 2) / 8
    state = in_hand(stacked())
    state.objects["cube_a"].lin_vel[:, 0] = 0.02
    assert TASK.reward(state).item() == pytest.approx(expected)


def test_the_expert_keeps_its_fingers_off_the_other_cube():
    """A neighbour along y, where fingers close at turn 0, turns the gripper by a quarter; one along x not."""
    assert abs(_clear_yaw(0.1, np.array([0.0, 0.06])) - 0.1) == pytest.approx(np.pi / 2)
    assert _clear_yaw(0.1, np.array([0.06, 0.0])) == pytest.approx(0.1)
    assert _clear_yaw(0.1, np.array([0.0, 0.3])) == pytest.approx(0.1)


def test_expert_regrasps_or_retracts():
    rng = np.random.default_rng(0)
    grasp = TASK.expert(stacked(dx=0.2, dz=0.0), rng)
    assert [waypoint.gripper for waypoint in grasp][-1] == 0.04
    assert min(waypoint.gripper for waypoint in grasp) == 0.0
    back = TASK.expert(stacked(), rng)
    assert [waypoint.gripper for waypoint in back] == [0.04]


def test_observation_is_made_of_poses_and_ways():
    state = stacked(dx=0.1, dz=0.0)
    row = TASK.observe(state)[0]
    assert row.shape == (26,)
    assert torch.equal(row[:3], state.objects["cube_a"].pos[0])
    torch.testing.assert_close(row[-3:], torch.tensor([-0.1, 0.0, 0.0], dtype=torch.float64))
