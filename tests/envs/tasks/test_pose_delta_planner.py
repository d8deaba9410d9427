"""The expert by pose deltas: what it waits for, and what it remembers."""

import dataclasses

import numpy as np
import torch

from envs.kinematics.waypoints import Waypoint
from envs.operational_space import DELTA_M
from envs.robots.franka import FRANKA_TORQUE
from envs.scenario import ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.pose_delta_planner import MOST_WAITED, PoseDeltaPlanner
from envs.tasks.tabletop import CONTROL_20_HZ

SCENARIO = ScenarioCfg(robots=(FRANKA_TORQUE,), physics=CONTROL_20_HZ)


def state_at(planner, pos, opening=0.04):
    """A hand that points down at a position, its fingers' targets at an opening."""
    targets = torch.zeros((1, 9), dtype=torch.float64)
    targets[0, 7:] = opening
    robot = EntityState.at_rest(np.zeros(3), np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 9)))
    robot = dataclasses.replace(
        robot,
        joint_target=targets,
        ee_pos=torch.tensor([pos], dtype=torch.float64),
        ee_rot=torch.from_numpy(planner._down[None].copy()),
    )
    return State({"franka": robot}, {})


def planner_to(*waypoints):
    """An expert with one plan: the waypoints, and then nothing."""
    asked = []

    def expert(state, rng):
        asked.append(state.robots["franka"].ee_pos[0].numpy())
        return list(waypoints) if len(asked) == 1 else []

    return PoseDeltaPlanner(SCENARIO, expert), asked


def to(x, gripper=0.04):
    return Waypoint(pos=np.array([x, 0.0, 0.3]), yaw=0.0, gripper=gripper, duration_s=0.05)


def test_an_action_leads_from_where_the_hand_is_to_the_path():
    planner, _ = planner_to(to(0.52))
    rng = np.random.default_rng(0)
    action = planner.plan(state_at(planner, [0.5, 0.0, 0.3]), rng)
    np.testing.assert_allclose(action, [[0.02 / DELTA_M, 0, 0, 0, 0, 0, -1]], atol=1e-6)
    action = planner.plan(state_at(planner, [0.51, 0.01, 0.3]), rng)
    np.testing.assert_allclose(action, [[0.01 / DELTA_M, -0.01 / DELTA_M, 0, 0, 0, 0, -1]], atol=1e-6)


def test_a_path_ends_when_the_hand_is_there_or_was_waited_for():
    planner, asked = planner_to(to(0.52))
    rng = np.random.default_rng(0)
    far, near = (state_at(planner, [x, 0.0, 0.3]) for x in (0.5, 0.519))
    assert len(planner.plan(far, rng)) == 1 and len(planner.plan(near, rng)) == 0
    assert len(asked) == 2
    planner, asked = planner_to(to(0.52))
    plans = [planner.plan(far, rng) for _ in range(MOST_WAITED + 2)]
    assert [len(plan) for plan in plans] == [1] * (MOST_WAITED + 1) + [0]


def test_the_fingers_close_before_the_hand_moves_on():
    planner, _ = planner_to(to(0.5), to(0.5, gripper=0.0), to(0.6, gripper=0.0))
    rng = np.random.default_rng(0)
    opened, closed = (state_at(planner, [0.5, 0.0, 0.3], opening) for opening in (0.04, 0.0))
    assert planner.plan(opened, rng)[0, 6] == -1.0
    shutting = planner.plan(opened, rng)[0]
    assert shutting[6] == 1.0 and shutting[0] == 0.0
    assert planner.plan(opened, rng)[0, 0] == 0.0, "the fingers are still open"
    assert planner.plan(closed, rng)[0, 0] == 1.0


def test_episodes_do_not_depend_on_each_other():
    planner, asked = planner_to(to(0.9))
    first, second = np.random.default_rng(0), np.random.default_rng(0)
    state = state_at(planner, [0.5, 0.0, 0.3])
    assert len(planner.plan(state, first)) == 1 and len(planner.plan(state, second)) == 0
    assert len(planner.plan(state, first)) == 1 and len(asked) == 2
