"""The numbers of PlaceSphere, RollBall, StackPyramid and PullCubeTool, by hand."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.tasks.maniskill.place_sphere import PlaceSphere
from envs.tasks.maniskill.pull_cube_tool import PullCubeTool
from envs.tasks.maniskill.roll_ball import RollBall
from envs.tasks.maniskill.stack_pyramid import StackPyramid
from tests.envs.tasks.table_states import assert_fills, grip, put, starts

SPHERE, ROLL, PYRAMID, TOOL = PlaceSphere(), RollBall(), StackPyramid(), PullCubeTool()


def test_ball_and_bin_start_apart():
    state = starts(SPHERE, 2000)
    ball, bin_ = state.objects["sphere"].pos, state.objects["bin"].pos
    for values, low, high in (
        (ball[:, 0], -0.1, -0.05),
        (ball[:, 1], -0.1, 0.1),
        (bin_[:, 0], 0.0, 0.1),
        (bin_[:, 1], -0.1, 0.1),
    ):
        assert_fills(values, low, high)
    assert (ball[:, 2] == 0.02).all() and (bin_[:, 2] == 0.0025).all()


def placed(dx=0.0, dz=0.0):
    state = starts(SPHERE)
    put(state, "bin", (0.05, 0.0, 0.0025))
    put(state, "sphere", (0.05 + dx, 0.0, 0.0025 + 0.0225 + dz))
    return state


@pytest.mark.parametrize(
    ("place", "solved"),
    [((0.0, 0.0), True), ((0.0049, 0.0049), True), ((0.0051, 0.0), False), ((0.0, -0.0051), False)],
)
def test_a_placed_ball_is_in_the_bin(place, solved):
    assert SPHERE.success(placed(*place)).tolist() == [solved]


def test_a_placed_ball_is_still_and_let_go():
    for field, value, solved in (
        ("lin_vel", 0.0099, True),
        ("lin_vel", 0.0101, False),
        ("ang_vel", 0.49, True),
        ("ang_vel", 0.51, False),
    ):
        state = placed()
        getattr(state.objects["sphere"], field)[:, 1] = value
        assert SPHERE.success(state).tolist() == [solved]
    state = placed()
    grip(state, (0.05, 0.0, 0.025), 0.04)
    assert SPHERE.success(state).tolist() == [False]
    state.robots["franka"].joint_target[:, 7:] = 0.04
    assert SPHERE.success(state).tolist() == [True]


def test_place_spheres_reward_by_hand():
    """2 (1 - tanh 5 r); held: 4 + near; in the bin: 6 + open + still; over 9."""
    state = placed(-0.1)
    hand = np.linalg.norm([0.05 - 0.1, 0.0, 0.025 - 0.3])
    assert SPHERE.reward(state).item() == pytest.approx(2 * (1 - np.tanh(5 * hand)) / 9)
    grip(state, state.objects["sphere"].pos[0].tolist(), 0.04)
    assert SPHERE.reward(state).item() == pytest.approx((4 + 1 - np.tanh(0.5)) / 9)
    state = placed()
    grip(state, (0.05, 0.0, 0.025), 0.04)
    assert SPHERE.reward(state).item() == pytest.approx((6 + 0.5 + 1) / 9)


def test_the_ball_starts_before_the_robot_and_the_target_is_at_the_other_end():
    state = starts(ROLL, 2000)
    ball, goal = state.objects["ball"].pos, state.objects["goal"].pos
    for values, low, high in (
        (ball[:, 0], -0.4, 0.2),
        (ball[:, 1], 0.5, 0.7),
        (goal[:, 0], -0.4, 0.2),
        (goal[:, 1], -0.9, -0.7),
    ):
        assert_fills(values, low, high)
    assert state.robots["franka"].pos[0].tolist() == [-0.1, 1.0, 0.0]


@pytest.mark.parametrize(("off", "solved"), [(0.0999, True), (0.1001, False)])
def test_a_ball_on_the_target_is_a_success_though_it_rolls_on(off, solved):
    state = starts(ROLL)
    put(state, "ball", (*(state.objects["goal"].pos[0, :2] + torch.tensor([0.0, off])).tolist(), 0.035))
    state.objects["ball"].lin_vel[:, 1] = -0.5
    assert ROLL.success(state).tolist() == [solved]


def test_a_rolling_ball_counts_its_way():
    """At rest and far from the hand 1 - tanh 2 r, rolling 1 + 20 (1 - tanh d); over 30."""
    state = starts(ROLL)
    put(state, "goal", (0.0, -0.8, 1e-3))
    put(state, "ball", (0.0, 0.5, 1e-3))  # level with the target, so that "behind" is level too
    reach = np.linalg.norm([0.0, 0.5 + 0.085, 1e-3 - 0.3])
    assert ROLL.reward(state).item() == pytest.approx((1 - np.tanh(2 * reach)) / 30)
    state.objects["ball"].lin_vel[:, 1] = -0.06
    assert ROLL.reward(state).item() == pytest.approx((1 + 20 * (1 - np.tanh(1.3))) / 30)


def test_the_expert_lets_a_ball_out_of_reach_go():
    state = starts(ROLL)
    put(state, "ball", (-0.1, 0.2, 0.035))
    assert ROLL.expert(state, np.random.default_rng(0)) == []


def test_the_expert_opens_its_fingers_while_the_hand_moves_to_the_target():
    state = starts(ROLL)
    put(state, "ball", (-0.1, 0.58, 0.035))
    put(state, "goal", (-0.1, -0.8, 1e-3))
    ways = ROLL.expert(state, np.random.default_rng(0))
    held = [index for index, way in enumerate(ways) if way.gripper == 0.0]
    last, first_open = ways[held[-1]], ways[held[-1] + 1]
    speed = np.linalg.norm(first_open.pos - last.pos) / first_open.duration_s
    assert 0.7 <= speed <= 0.8
    assert first_open.pos[0] == pytest.approx(-0.1) and first_open.pos[1] < last.pos[1]


def test_three_cubes_start_apart():
    state = starts(PYRAMID, 1000)
    cubes = [state.objects[name].pos for name in ("cube_a", "cube_b", "cube_c")]
    least = 2 * (np.sqrt(2) * 0.02 + 0.001)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert torch.linalg.vector_norm(cubes[one] - cubes[other], dim=-1).min() > least
    assert all(cube[:, 0].abs().max() <= 0.2 and cube[:, 1].abs().max() <= 0.3 for cube in cubes)


def pyramid(gap=0.042, top=(0.0, 0.06)):
    """A beside B, and C over their middle, off by ``top[0]`` and at the height ``top[1]``."""
    state = starts(PYRAMID)
    put(state, "cube_b", (0.0, 0.0, 0.02))
    put(state, "cube_a", (gap, 0.0, 0.02))
    put(state, "cube_c", (gap / 2 + top[0], 0.0, top[1]))
    return state


@pytest.mark.parametrize(
    ("place", "solved"),
    [
        ({}, True),
        ({"gap": 0.0615}, True),  # 2 √2 · 0.02 + 0.005 = 0.06157
        ({"gap": 0.0617}, False),
        ({"top": (0.0, 0.0401)}, True),
        ({"top": (0.0, 0.0399)}, False),
        ({"top": (0.0405, 0.06)}, True),  # 0.0615 from one of them
        ({"top": (0.0407, 0.06)}, False),
    ],
)
def test_a_pyramid_has_two_cubes_below_and_one_above_both(place, solved):
    assert PYRAMID.success(pyramid(**place)).tolist() == [solved]


def test_a_pyramid_is_still_and_let_go():
    state = pyramid()
    state.objects["cube_c"].lin_vel[:, 0] = 0.0101
    assert PYRAMID.success(state).tolist() == [False]
    for name in ("cube_a", "cube_c"):
        state = pyramid()
        grip(state, state.objects[name].pos[0].tolist(), 0.04)
        assert PYRAMID.success(state).tolist() == [False]


def test_the_expert_builds_the_lower_row_first():
    """The first cube's fingers close across the row; its place is a side and 2 mm from the other's."""
    state = starts(PYRAMID)
    for name, y in (("cube_a", 0.15), ("cube_b", 0.0), ("cube_c", -0.15)):
        put(state, name, (0.0, y, 0.02), 0.2)
    ways = PYRAMID.expert(state, np.random.default_rng(0))
    place = ways[-2].pos[:2]
    assert np.linalg.norm(place) == pytest.approx(0.042)
    fingers = np.array([-np.sin(ways[-2].yaw), np.cos(ways[-2].yaw)])
    assert abs(place @ fingers) < 1e-9
    state = pyramid()
    put(state, "cube_c", (0.0, -0.15, 0.02))
    top = PYRAMID.expert(state, np.random.default_rng(0))[-2].pos
    np.testing.assert_allclose(top, [0.021, 0.0, 0.061])


def test_tool_and_cube_start_apart_in_maniskills_ranges():
    state = starts(TOOL, 2000)
    tool, cube = state.objects["tool"].pos, state.objects["cube"].pos
    assert_fills(tool[:, 0], -0.3, -0.1)
    assert_fills(tool[:, 1], -0.3, -0.1)
    assert_fills(cube[:, 0], 0.05, 0.25)
    assert_fills(cube[:, 1], -0.25, 0.05)
    x, y = (cube - tool)[:, 0].numpy(), (cube - tool)[:, 1].numpy()
    edge = 0.02 * np.sqrt(2)
    in_handle = (x < 0.2 + edge) & (np.abs(y) < 0.025 + edge)
    in_hook = (x > 0.15 - edge) & (x < 0.2 + edge) & (y > -edge) & (y < 0.1 + edge)
    assert not (in_handle | in_hook).any()


@pytest.mark.parametrize(("away", "solved"), [(0.5999, True), (0.6001, False)])
def test_a_near_cube_is_a_success(away, solved):
    state = starts(TOOL)
    put(state, "cube", (-0.615 + 0.8 * away, -0.6 * away, 0.02))
    assert TOOL.success(state).tolist() == [solved]


def test_the_tools_reward_does_not_depend_on_how_the_row_is_turned():
    """Tool, cube and hand turned about the base as one: the same reward, with all of its stages."""
    rewards = []
    for turn in (0.0, -0.3):
        cos, sin = np.cos(turn), np.sin(turn)

        def at(x, y, cos=cos, sin=sin):
            return -0.615 + cos * x - sin * y, sin * x + cos * y

        state = starts(TOOL)
        put(state, "tool", (*at(0.6, -0.06), 0.025), turn)
        put(state, "cube", (*at(0.7, 0.0), 0.02), turn)
        grip(state, (*at(0.63, -0.06), 0.025), 0.05)
        rewards.append(TOOL.reward(state).item())
    x, y = 0.2 - 0.05 - 0.026, 0.025 + 0.038
    placed = 1 - np.tanh(3 * np.linalg.norm([0.1 - x, 0.06 - y, -0.005]))
    assert rewards == pytest.approx([(2 + 2 + 1.5 * placed + 3 * 0.3) / 8.6] * 2)


def test_the_expert_sets_the_hook_down_behind_the_cube_and_pulls_it_over_the_line():
    state = starts(TOOL)
    put(state, "cube", (0.2, 0.0, 0.02))
    put(state, "tool", (-0.2, -0.2, 0.025))
    down, pull = TOOL.expert(state, np.random.default_rng(0))[-2:]
    hook = down.pos[0] - 0.03 + 0.15
    assert hook > 0.2 + 0.02 and down.pos[1] < 0.0
    pulled = hook - 0.2 - 0.02 + (0.815 - 0.6)
    assert down.pos[0] - pull.pos[0] > pulled


def test_a_reversed_range_is_refused():
    with pytest.raises(ConfigError, match=r"cube_x_m is a range, from the lower to the higher"):
        PullCubeTool(cube_x_m=(0.2, 0.1))
    with pytest.raises(ConfigError, match=r"task_kwargs\.cube_x_m is 2 numbers, such as"):
        PullCubeTool(cube_x_m=(0.2,))


def test_a_hand_beyond_reach_tips_its_fingers_ahead():
    state = starts(TOOL)
    tips = []
    for x in (0.05, 0.25):
        put(state, "cube", (x, -0.2, 0.02))
        tips.append(TOOL.expert(state, np.random.default_rng(0))[-1].pitch)
    assert tips[1] < tips[0] <= 0.0
