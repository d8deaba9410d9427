"""NutAssembly's numbers, by hand, and the grip on a nut."""

import numpy as np
import pytest
import torch

from envs.core.errors import UnknownNameError
from envs.gym_env import make_vec
from envs.rotations import from_yaw, multiply, yaw_of
from envs.tasks.nut_assembly import (
    YAW_RANGE_RAD,
    NutAssembly,
    NutAssemblySquare,
    _grasp_turn,
    _on_handle,
)
from envs.tasks.robosuite.nuts import ROUND_NUT
from envs.tasks.tabletop import hand_yaw

BOTH, SQUARE = NutAssembly(), NutAssemblySquare()
SQUARE_PEG, ROUND_PEG = (0.23, 0.1), (0.23, -0.1)


def states(task=BOTH, count=1):
    return task.initial_state([np.random.default_rng(i) for i in range(count)])


def vector(*values):
    return torch.tensor([values], dtype=torch.float64)


def assembled(task=BOTH, dx=0.0, dy=0.0, z=0.01, reach=0.3):
    """Both nuts on their pegs, the square one off by (dx, dy); the hand at ``reach`` above the square one."""
    state = states(task)
    state.objects["square_nut"].pos = vector(SQUARE_PEG[0] + dx, SQUARE_PEG[1] + dy, z)
    if "round_nut" in state.objects:
        state.objects["round_nut"].pos = vector(*ROUND_PEG, 0.01)
    robot = state.robots["franka"]
    robot.ee_pos = state.objects["square_nut"].pos + vector(0.0, 0.0, reach)
    robot.ee_rot = torch.tensor([[0.0, 1.0, 1.0, 0.0]], dtype=torch.float64) / np.sqrt(2)  # down, turn 0
    robot.joint_target = robot.joint_pos.clone()
    return state


def test_initial_states_fill_robosuites_ranges():
    state = states(count=4000)
    for name, side in (("square_nut", 1), ("round_nut", -1)):
        nut = state.objects[name].pos
        for values, low, high in ((nut[:, 0], -0.115, -0.11), (side * nut[:, 1], 0.11, 0.225)):
            assert low <= values.min() < low + 0.01 * (high - low)
            assert high >= values.max() > high - 0.01 * (high - low)
        assert (nut[:, 2] == 0.01).all()
        heading = 2 * torch.atan2(state.objects[name].rot[:, 3], state.objects[name].rot[:, 0])
        assert heading.cos().mean().abs() < 0.05
        assert heading.sin().mean().abs() < 0.05
    assert state.objects["square_peg"].pos[7].tolist() == pytest.approx([0.23, 0.1, 0.03])
    assert state.objects["round_peg"].pos[7].tolist() == pytest.approx([0.23, -0.1, 0.03])
    arm = state.robots["franka"].joint_pos[:, :7] - torch.tensor(BOTH.scenario.robots[0].default_qpos[:7])
    assert arm.std().item() == pytest.approx(0.02, rel=0.05)


def test_nuts_start_apart():
    """Ring and handle stay within 0.08525 m of a nut's centre; centres are 0.22 m apart or more."""
    state = states(count=1000)
    square, other = state.objects["square_nut"].pos, state.objects["round_nut"].pos
    assert torch.linalg.vector_norm(square - other, dim=-1).min() > 2 * 0.0853


@pytest.mark.parametrize(
    ("dx", "dy", "z", "solved"),
    [
        (0.0, 0.0, 0.01, True),
        (0.0299, -0.0299, 0.0499, True),
        (0.0301, 0.0, 0.01, False),
        (0.0, -0.0301, 0.01, False),
        (0.0, 0.0, 0.0501, False),
    ],
)
@pytest.mark.parametrize("task", [BOTH, SQUARE])
def test_success_is_round_the_peg_and_low(task, dx, dy, z, solved):
    assert task.success(assembled(task, dx, dy, z)).tolist() == [solved]


@pytest.mark.parametrize(("reach", "solved"), [(0.0423, False), (0.0424, True)])
def test_success_is_away_from_the_nut(reach, solved):
    """1 - tanh(10 d) < 0.6 where d > atanh(0.4) / 10 = 0.042365."""
    assert SQUARE.success(assembled(SQUARE, reach=reach)).tolist() == [solved]


def test_success_takes_both_nuts_on_their_own_pegs():
    state = assembled()
    state.objects["round_nut"].pos = vector(-0.11, -0.2, 0.01)
    assert not BOTH.success(state).any()
    state.objects["round_nut"].pos = vector(*SQUARE_PEG, 0.01)
    state.objects["square_nut"].pos = vector(*ROUND_PEG, 0.01)
    assert not BOTH.success(state).any()


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_what_is_not_finite_is_no_success(value):
    for axis in range(2):
        state = assembled()
        state.objects["round_nut"].pos[:, axis] = value
        assert not BOTH.success(state).any()
    state = assembled()
    state.robots["franka"].ee_pos[:] = torch.nan
    assert not BOTH.success(state).any()


@pytest.mark.parametrize(
    ("offset", "z", "solved"),
    [(0.0199, 0.0799, True), (0.0201, 0.01, False), (0.0, 0.0801, False)],
)
def test_the_papers_variant_by_hand(offset, z, solved):
    """Within 2 cm of the axis, less than 5 cm above the peg's middle (0.03); held or not."""
    state = assembled(SQUARE, offset * 0.6, offset * 0.8, z, reach=0.0)
    assert NutAssemblySquare(variant="roboverse").success(state).tolist() == [solved]


@pytest.mark.parametrize("task", [NutAssembly, NutAssemblySquare])
def test_a_wrong_variant_is_named(task):
    with pytest.raises(
        UnknownNameError, match=rf"variant of {task.name} 'robosuit'\. Did you mean 'robosuite'"
    ):
        task(variant="robosuit")


def between_nuts(hand):
    """The square nut on its peg, and the open hand at a place (3,)."""
    state = assembled()
    state.objects["round_nut"].pos = vector(-0.112, -0.17, 0.01)
    state.robots["franka"].ee_pos = vector(*hand)
    return state


@pytest.mark.parametrize("seed", range(5))
def test_expert_stops_before_the_second_nut_where_the_wrist_sees_it(seed):
    state = between_nuts(hand=(0.165, 0.1, 0.18))
    look, over, *_ = BOTH.expert(state, np.random.default_rng(seed))
    assert look.pos == pytest.approx([-0.105, -0.1, 0.19], abs=0.04)  # 4 standard deviations of 1 cm
    assert abs(look.yaw) < 0.4  # turned as at the start, whatever the handle's direction
    handle = _on_handle(state.objects["round_nut"], ROUND_NUT.grip_m)[0, :2].numpy()
    assert over.pos[:2] == pytest.approx(handle, abs=0.15)  # by a point beside it, 3 cm off, at times
    assert over.yaw == _grasp_turn(float(yaw_of(state.objects["round_nut"].rot[0].numpy())))


def test_a_robots_place_is_sought_for_the_stop_too():
    state = between_nuts(hand=(-0.1, 0.0, 0.19))  # from where no stop is needed
    state.objects["square_nut"].pos = vector(-0.112, 0.17, 0.01)
    ways = BOTH.foreseen(state, np.random.default_rng(0))
    stop = np.array([-0.105, -0.1, 0.19])
    assert min(np.linalg.norm(way.pos - stop) for way in ways if abs(way.yaw) < 0.4) < 0.05


def test_expert_that_is_near_the_second_nut_takes_it_at_once():
    state = between_nuts(hand=(-0.1, -0.1, 0.18))
    first, *_ = BOTH.expert(state, np.random.default_rng(0))
    assert first.yaw == _grasp_turn(float(yaw_of(state.objects["round_nut"].rot[0].numpy())))


def test_reward_by_hand():
    """robosuite's staged rewards: reach 0.1, grasp 0.35, lift to 0.5, hover to 0.7, nut on its peg 1."""
    state = assembled(SQUARE, dx=-0.3, reach=0.1)
    state.objects["square_nut"].rot = torch.from_numpy(from_yaw(np.zeros(1)))
    reach = 0.1 * (1 - np.tanh(10 * np.hypot(0.1, 0.054)))
    hover = 0.2 * (1 - np.tanh(10 * 0.3))
    assert SQUARE.reward(state).item() == pytest.approx(max(reach, hover))
    # Gripped at the handle at z = 0.1, 0.075 below the height to lift to, and 0.1 from the peg.
    state = assembled(SQUARE, dx=-0.1, z=0.1)
    state.objects["square_nut"].rot = torch.from_numpy(from_yaw(np.zeros(1)))
    robot = state.robots["franka"]
    robot.ee_pos = state.objects["square_nut"].pos + vector(0.062, 0.0, 0.0)
    robot.joint_pos[:, 7:], robot.joint_target[:, 7:] = 0.0155, 0.0
    lift = 0.35 + 0.15 * (1 - np.tanh(15 * 0.075))
    hover = lift + 0.2 * (1 - np.tanh(10 * 0.1))
    assert SQUARE.reward(state).item() == pytest.approx(hover)
    # Of two nuts one is done: half of it all, and the stages are those of the other one.
    state = assembled()
    state.objects["round_nut"].pos = vector(-0.11, -0.2, 0.01)
    hover = 0.2 * (1 - np.tanh(10 * np.hypot(0.34, 0.1)))
    reach = 0.1 * (1 - np.tanh(10 * 0.42))
    assert BOTH.reward(state).item() == pytest.approx((1 + hover) / 2, abs=1e-3)
    assert reach < hover


def test_every_handle_can_be_taken_and_turned_to_the_robot():
    """The nut has turned with the hand: its handle points along -x, or 8° off where the wrist ends."""
    low, high = YAW_RANGE_RAD
    for heading in np.linspace(-np.pi, np.pi, 400):
        turn = _grasp_turn(float(heading))
        assert low <= turn <= high
        across = (turn - heading) % np.pi  # fingers close across the handle, either way round
        assert min(across, np.pi - across) < 0.15
        place = [turn + (np.pi - heading) + 2 * np.pi * k for k in (-2, -1, 0, 1)]
        assert min(max(low - p, p - high, 0.0) for p in place) < 0.15


def test_expert_picks_the_nut_that_is_not_on_its_peg():
    rng = np.random.default_rng(0)
    state = assembled()
    assert [waypoint.gripper for waypoint in BOTH.expert(state, rng)] == [0.04]  # all done: away
    state.objects["round_nut"].pos = vector(-0.11, -0.2, 0.01)
    state.objects["round_nut"].rot = torch.from_numpy(from_yaw(np.zeros(1)))
    *above, grasp, close, lift = BOTH.expert(state, rng)
    assert grasp.pos == pytest.approx([-0.11 + 0.068, -0.2, 0.01])
    assert [way.gripper for way in (*above, grasp)] == [0.04] * (len(above) + 1)
    assert (close.gripper, lift.gripper) == (0.0, 0.0)


@pytest.mark.parametrize("turn", [-2.5, 0.0, 0.3, 3.0])
def test_the_turn_of_a_hand_is_that_of_its_waypoint(turn):
    robot = assembled().robots["franka"]
    robot.ee_rot = torch.from_numpy(multiply(from_yaw(np.array([turn])), robot.ee_rot.numpy()))
    assert hand_yaw(robot) == pytest.approx(turn)


def test_observation_says_where_to_go():
    state = assembled(dx=0.01)
    row = BOTH.observe(state)
    assert row.shape == (1, 29)
    assert SQUARE.observe(assembled(SQUARE)).shape == (1, 16)
    assert row[0, 13:16].tolist() == pytest.approx([-0.01, 0.0, 0.02])


@pytest.mark.slow
def test_a_nut_is_held_for_ten_seconds():
    """What the fingers lift stays between them: it creeps by less than half a millimetre."""
    env = make_vec("NutAssembly", split="test", observation="state")
    try:
        env.reset_envs([0], env.split_indices[:1])
        actions = env.task.planner.plan(env.get_states(), np.random.default_rng(0))

        def in_hand():
            state = env.get_states()
            assert state.objects["square_nut"].pos[0, 2] > 0.15
            return state.objects["square_nut"].pos - state.robots["franka"].ee_pos

        for action in (*actions, *[actions[-1]] * 20):
            env.step_envs([0], action[None])
        before = in_hand()
        for _ in range(200):
            env.step_envs([0], actions[-1][None])
        assert torch.linalg.vector_norm(in_hand() - before) < 5e-4
    finally:
        env.close()
