"""Tasks of an SO-101: their scene, their rules, and the numbers that a policy reads."""

import numpy as np
import pytest
import torch
from lerobot.robots import make_robot_from_config

from envs.experts.actor import expert_episodes
from envs.lerobot import RoboVerseEnvConfig, RoboVerseRobotConfig
from envs.rotations import from_yaw, multiply
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks import TASKS
from envs.tasks.arm_at_table import chain_at_rest
from envs.tasks.make import make_task
from envs.tasks.skills.moves import Hand
from envs.tasks.so101.cubes import HALF_M, REACH_M
from envs.tasks.so101.scene import LOW_M, OPEN_M
from roboverse_learn.data.sources.expert import ExpertEpisodes

NAMES = [name for name in TASKS if name.startswith("so101/")]
JOINTS = tuple(
    f"{name}.pos"
    for name in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
)


def starts(task, count=200):
    return task.initial_state([np.random.default_rng(index) for index in range(count)])


def with_targets(state, task):
    """Returns the state with targets and a hand, as a simulator gives them."""
    arm = state.robots[task.robot.name]
    arm.joint_target = arm.joint_pos.clone()
    arm.ee_pos = torch.zeros((state.num_envs, 3), dtype=torch.float64)
    return state


def test_the_family_has_four_tasks():
    assert sorted(NAMES) == [
        "so101/open_drawer",
        "so101/pick_cube",
        "so101/push_cube",
        "so101/stack_cube",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_scene_and_actions_are_those_of_lerobots_arm(name):
    task = make_task(name)
    assert task.scenario.physics.control_hz == pytest.approx(30.0)
    assert [(camera.name, camera.width, camera.height) for camera in task.scenario.cameras] == [
        ("front", 640, 480),
        ("wrist", 640, 480),
    ]
    assert task.state_names == task.controller.names == JOINTS


def test_images_keep_the_cameras_aspect_at_any_size():
    scene = make_task("so101/pick_cube").scenario
    sizes = {size: scene.seen_by(("front",), size).cameras[0] for size in (64, 96, 480)}
    assert {(camera.width, camera.height) for camera in sizes.values()} == {(86, 64), (128, 96), (640, 480)}
    square = make_task("PickCube").scenario.seen_by(None, 100).cameras[0]
    assert (square.width, square.height) == (100, 100)


def test_cubes_start_within_reach_and_apart():
    pick, stack = starts(make_task("so101/pick_cube")), starts(make_task("so101/stack_cube"))
    far = torch.linalg.vector_norm(pick.objects["cube"].pos[:, :2], dim=1)
    assert REACH_M[0] <= far.min() and far.max() <= REACH_M[1]
    between = torch.linalg.vector_norm(stack.objects["red"].pos - stack.objects["green"].pos, dim=1)
    assert between.min() >= 0.085


def test_a_target_is_never_reached_at_the_start():
    task = make_task("so101/push_cube")
    assert not task.success(starts(task)).any()


def test_a_cube_is_lifted_only_where_the_fingers_hold_it():
    task = make_task("so101/pick_cube")
    state = with_targets(starts(task, 3), task)
    arm, cube = state.robots["so101"], state.objects["cube"]
    cube.pos[:, 2] = HALF_M + 0.05
    arm.ee_pos[:] = cube.pos + torch.tensor([0.0, 0.0, LOW_M - HALF_M])
    arm.joint_pos[:, 5], arm.joint_target[:, 5] = 0.3, task.robot.joints[5].range[0]
    assert task.success(state).all()
    arm.joint_target[:, 5] = 0.3  # the fingers no longer press
    assert not task.success(state).any()
    arm.joint_target[:, 5] = task.robot.joints[5].range[0]
    cube.pos[:, 2] = HALF_M + 0.03
    assert not task.success(state).any()


def test_a_stack_counts_once_it_is_let_go():
    task = make_task("so101/stack_cube")
    state = with_targets(starts(task, 2), task)
    red, green, arm = state.objects["red"], state.objects["green"], state.robots["so101"]
    red.pos[:] = green.pos + torch.tensor([0.0, 0.0, 2 * HALF_M])
    arm.ee_pos[:] = red.pos
    arm.joint_pos[:, 5], arm.joint_target[:, 5] = 0.3, task.robot.joints[5].range[0]
    assert not task.success(state).any()
    arm.joint_pos[:, 5] = arm.joint_target[:, 5] = 0.6
    assert task.success(state).all()
    red.pos[:, 0] += HALF_M + 0.002
    assert not task.success(state).any()


def test_rewards_rise_with_progress_and_stay_below_one():
    task = make_task("so101/open_drawer")
    state = with_targets(starts(task, 4), task)
    shut = task.reward(state)
    state.objects["cabinet"].joint_pos[:] = 0.03
    half = task.reward(state)
    state.objects["cabinet"].joint_pos[:] = 0.06
    assert (shut < half).all() and (half < task.reward(state)).all() and (task.reward(state) < 1).all()
    assert task.success(state).all()


def test_the_turn_of_a_hand_is_that_of_its_waypoint_whatever_its_frame():
    """At turn 0 the jaw opens away from the base, and fingers of a Panda to its left."""
    task = make_task("so101/stack_cube")
    state = with_targets(starts(task, 1), task)
    arm = state.robots["so101"]
    for turn in (-0.9, 0.0, 0.4):
        rest = chain_at_rest(task.robot)[1]
        arm.ee_rot = torch.from_numpy(multiply(from_yaw(np.array([turn])), rest))
        assert Hand.of(task, state, np.random.default_rng(0)).yaw == pytest.approx(turn)


def test_a_low_hand_rises_from_where_its_targets_are():
    task = make_task("so101/pick_cube")
    state = with_targets(starts(task, 1), task)
    arm = state.robots["so101"]
    assert task.rise(state, 0.06) == [], "at rest it is 8 cm above the table"
    arm.joint_target[:, 1] += 0.4
    now = task.commanded(state)
    (up,) = task.rise(state, now.pos[2] + 0.02)
    assert now.pos[2] != pytest.approx(arm.ee_pos[0, 2].item())
    np.testing.assert_allclose(up.pos, now.pos + np.array([0.0, 0.0, 0.02]))
    assert (up.yaw, up.pitch, up.gripper) == (now.yaw, now.pitch, OPEN_M)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_expert_solves_its_first_starts(name):
    env = EnvSpec(task=name).make(4, observation="state")
    try:
        done = list(expert_episodes(env, env.split_indices[:4].tolist(), record=()))
    finally:
        env.close()
    assert all(episode.success for episode in done)


@pytest.mark.slow
def test_the_expert_corrects_a_hand_that_is_turned_wrongly_above_the_cube():
    env = EnvSpec(task="so101/pick_cube", task_kwargs={"turn_miss_rad": 0.7}).make(8, observation="state")
    try:
        task = env.task
        env.reset_envs(list(range(8)), env.split_indices[:8].tolist())
        states = env.get_states(np.arange(8))
        wrong = []
        for row in range(8):
            ways = task.expert(states.select([row]), np.random.default_rng(row))
            low = [way for way in ways if way.pos[2] < 0.03]
            assert {round(way.yaw, 6) for way in low} == {round(low[0].yaw, 6)}, (
                "it is right before it comes down"
            )
            wrong.append(abs(ways[0].yaw - low[0].yaw))
        assert 0.0 in wrong and 0.1 < max(wrong) <= 0.7
        done = list(expert_episodes(env, env.split_indices[:8].tolist(), record=()))
    finally:
        env.close()
    assert all(episode.success for episode in done)


@pytest.mark.slow
def test_recorded_states_are_what_every_live_observation_shows(tmp_path):
    """A dataset in other units than the observations of an evaluation trains a policy that fails in all."""
    spec = EnvSpec(task="so101/pick_cube", image_size=32)
    source = ExpertEpisodes(env=spec.to_json(), num_envs=1)
    try:
        episode = next(data for _, data in source.attempts([0]) if data is not None)
    finally:
        source.close()
    steps = 20
    env = spec.make(1)
    plugin = RoboVerseEnvConfig(task="so101/pick_cube", image_size=32, split="train").create_envs(1)
    other = plugin["roboverse"][0]
    config = RoboVerseRobotConfig(
        task="so101/pick_cube", image_size=32, episodes=(0,), calibration_dir=tmp_path
    )
    robot = make_robot_from_config(config)
    robot.connect()
    try:
        env.reset_envs([0], [0])
        shown, _ = other.reset(options={"episodes": [0]})
        for step in range(steps):
            recorded, action = episode.states[step], episode.actions[step]
            assert np.array_equal(env.observe()["observation.state"][0], recorded), (
                "an evaluation's observation"
            )
            assert np.array_equal(shown["agent_pos"][0], recorded), "LeRobot's environment"
            seen = robot.get_observation()
            assert np.array_equal(np.float32([seen[name] for name in JOINTS]), recorded), "LeRobot's robot"
            env.step_envs([0], action[None])
            shown = other.step(action[None])[0]
            robot.send_action(dict(zip(JOINTS, action.tolist(), strict=True)))
    finally:
        robot.disconnect()
        other.close()
        env.close()
    assert np.abs(episode.states[0, :5]).max() > 20.0, "degrees, not radians"
    assert 30.0 < episode.states[0, 5] < 50.0, "percent of the gripper's range"
    follows = np.abs(episode.states[1:, :5] - episode.actions[:-1, :5])
    assert np.median(follows) < 2.0, "actions are in the units of states"


def test_positions_of_a_task_of_another_robot_stay_as_they_are():
    task = make_task("PickCube")
    state: State = starts(task, 2)
    assert task.proprioception(state) is state.robots["franka"].joint_pos
    assert task.state_names == task.robot.joint_names
