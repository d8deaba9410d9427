"""Hand paths: what is read from states, how an arm reaches one, and one by one or all at once."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.robots import ROBOTS
from envs.rotations import from_yaw
from envs.spec import EnvSpec
from envs.state import EntityState, State
from roboverse_learn.data.augmentation.pose import Pose, angle_rad
from roboverse_learn.data.retargeting.hand_path import HandPath, HandPathReader, check_hands
from roboverse_learn.data.retargeting.planner import RetargetPlanner, approached

FRANKA = ROBOTS.get("franka")


def states(base_pos, base_yaw, targets):
    """Returns states of a Franka at rest whose targets are given, (T + 1, 9)."""
    count = len(targets)
    entity = EntityState.at_rest(
        np.array(base_pos, float),
        np.tile(from_yaw(base_yaw), (count, 1)),
        np.tile(FRANKA.default_qpos, (count, 1)),
    )
    entity.joint_target = torch.from_numpy(np.array(targets, np.float64))
    return State({"franka": entity}, {})


def path_of(pos, first_act):
    count = len(pos) - 1
    rot = np.tile([1.0, 0.0, 0.0, 0.0], (count + 1, 1))
    every = Pose(np.asarray(pos, float), rot)
    return HandPath(every.rows(slice(0, 1)), every.rows(slice(1, None)), np.full(count, 0.04), first_act)


def test_a_path_is_that_of_the_targets_in_the_world_of_the_recorded_base():
    rest = np.array(FRANKA.default_qpos)
    targets = np.tile(rest, (5, 1))
    targets[3:, 7:] = 0.01
    targets[4, 0] += 0.3
    plain = HandPathReader(FRANKA).read(states((0.0, 0.0, 0.0), 0.0, targets))
    assert plain.num_steps == 4
    assert plain.first_act == 2  # the third step closes the fingers
    np.testing.assert_allclose(plain.half_gap_m, [0.04, 0.04, 0.01, 0.01])
    # The first joint is vertical and 0.3 rad turn the hand about it.
    x, y, z = plain.poses.pos[0]
    turned = (x * np.cos(0.3) - y * np.sin(0.3), x * np.sin(0.3) + y * np.cos(0.3), z)
    np.testing.assert_allclose(plain.poses.pos[3], turned, atol=1e-9)
    moved = HandPathReader(FRANKA).read(states((1.0, -2.0, 0.5), np.pi / 2, targets))
    np.testing.assert_allclose(moved.poses.pos[0], (1.0 - y, -2.0 + x, 0.5 + z), atol=1e-9)


def test_states_of_another_robot_are_refused():
    with pytest.raises(ConfigError, match=r"states are of franka, and 'ur5e' with 8 joints was expected"):
        HandPathReader(ROBOTS.get("ur5e")).read(states((0, 0, 0), 0.0, [FRANKA.default_qpos]))


def test_an_offset_start_reaches_the_path_before_the_gripper_acts():
    pos = [[0.1 * step, 0.0, 0.0] for step in range(9)]
    start = Pose(np.array([[0.0, 0.05, 0.0]]), from_yaw(np.array([0.2])))
    path = path_of(pos, first_act=4)
    way = approached(path, start, blend_steps=10)
    np.testing.assert_allclose(way.pos[:, 0], path.poses.pos[:, 0])
    # Least jerk after half of the time is half of the way: 10 / 8 - 15 / 16 + 6 / 32 = 1 / 2.
    assert way.pos[1, 1] == pytest.approx(0.025)
    np.testing.assert_allclose(way.pos[3:, 1], 0.0, atol=1e-12)
    assert angle_rad(way.rows(1), path.poses.rows(1)) == pytest.approx(0.1)
    np.testing.assert_allclose(way.rot[3:], path.poses.rot[3:], atol=1e-12)


def test_a_hand_that_starts_on_the_path_follows_it_exactly():
    path = path_of([[0.1 * step, 0.0, 0.0] for step in range(4)], first_act=3)
    way = approached(path, path.start, blend_steps=10)
    np.testing.assert_allclose(way.pos, path.poses.pos)
    np.testing.assert_allclose(way.rot, path.poses.rot)


def test_a_gripper_that_acts_at_once_or_never_is_followed():
    start = Pose(np.array([[0.0, 0.05, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
    pos = [[0.1 * step, 0.0, 0.0] for step in range(4)]
    assert approached(path_of(pos, first_act=0), start, 10).pos[:, 1].tolist() == [0.0, 0.0, 0.0]
    ends = approached(path_of(pos, first_act=3), start, 10).pos[-1, 1]
    assert ends == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_paths_are_followed_alike_one_by_one_and_all_at_once():
    task = EnvSpec(task="PickCube", robot="ur5e").make_task()
    own = EnvSpec(task="PickCube").make_task()
    start = task.initial_state([np.random.default_rng(seed) for seed in range(2)])
    rest = np.array(own.robot.default_qpos)
    paths = []
    for count in (12, 30):
        targets = np.tile(rest, (count + 1, 1))
        targets[:, 0] += np.linspace(0.0, 0.3, count + 1)
        targets[count // 2 :, 7:] = 0.0
        paths.append(HandPathReader(own.robot).read(states(own.robot.pos, 0.0, targets)))
    single, batch = (RetargetPlanner(task, at_once=at_once).plan(start, paths) for at_once in (False, True))
    for path, one, other in zip(paths, single, batch, strict=True):
        assert one.targets.shape == other.targets.shape == (path.num_steps, 8)
        assert max(one.missed_m, other.missed_m) < 1e-3 and max(one.missed_rad, other.missed_rad) < 5e-3
        np.testing.assert_allclose(one.targets, other.targets, atol=0.02)
        assert one.targets[-1, 6:].tolist() == [0.0, 0.0]
        alone = RetargetPlanner(task).plan(start.select([paths.index(path)]), [path])
        np.testing.assert_array_equal(alone[0].targets, one.targets)


def test_robots_and_tasks_without_a_hand_to_follow_are_refused():
    task = EnvSpec(task="PickCube").make_task()
    with pytest.raises(ConfigError, match=r"joint targets, and cartpole has no gripper\. Use source=expert"):
        check_hands(task, (ROBOTS.get("cartpole"), FRANKA))
