import dataclasses
import math

import numpy as np
import pytest

from envs.core.errors import DatasetError
from envs.rotations import from_yaw, multiply
from envs.state import EntityState
from envs.tasks import TASKS
from roboverse_learn.data.importers.demonstration import (
    Placement,
    SceneMapping,
    angular_velocities,
    array,
    assemble,
    check_scene,
    place_base,
    servo_targets,
    velocities,
    within_range,
)

ROBOT = TASKS.get("PickCube")().scenario.robots[0]


def test_velocities_are_backward_differences_and_none_before_a_jump():
    positions = np.array([[0.0], [5.0], [5.1], [5.3]])
    np.testing.assert_allclose(velocities(positions, 20.0)[:, 0], [0.0, 100.0, 2.0, 4.0])
    np.testing.assert_allclose(velocities(positions, 20.0, first=1)[:, 0], [0.0, 0.0, 2.0, 4.0])


def test_angular_velocities_are_in_the_turning_frame_and_take_the_short_way():
    # A body on its side (its z axis is the world's x) turns by 0.1 rad about the world's x.
    lying = np.array([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])
    about_x = np.array([math.cos(0.05), math.sin(0.05), 0.0, 0.0])
    rotations = np.stack([lying, -multiply(about_x, lying)])
    np.testing.assert_allclose(angular_velocities(rotations, 20.0), [[0, 0, 0], [0, 0, 2.0]], atol=1e-12)
    assert not angular_velocities(np.stack([lying] * 3), 20.0).any()


def test_servo_targets_are_followed_by_a_first_order_lag():
    rng = np.random.default_rng(0)
    qpos = np.array(ROBOT.default_qpos) + 0.02 * rng.random((20, 9)).cumsum(axis=0) * ([1] * 7 + [0, 0])
    targets = servo_targets(ROBOT, qpos, 20.0)
    assert targets.shape == (19, 9)
    lag_s = np.array([joint.kd / joint.kp for joint in ROBOT.joints])
    followed = qpos[:-1] + (1 - np.exp(-0.05 / lag_s)) * (targets - qpos[:-1])
    inside = np.all(targets == within_range(ROBOT, targets), axis=0) & (np.abs(targets).max(axis=0) < 1.5)
    np.testing.assert_allclose(followed[:, inside], qpos[1:, inside], atol=1e-12)
    assert inside.any()
    low, high = np.array([joint.range for joint in ROBOT.joints]).T
    assert (targets >= low).all() and (targets <= high).all()


def test_a_base_is_put_on_ours_by_turning_about_z_alone():
    # Their base is at (1, 2), turned by 90 degrees and slightly tilted; the table is at 0.8 m.
    tipped = multiply(from_yaw(np.pi / 2), np.array([math.cos(0.002), 0.0, math.sin(0.002), 0.0]))
    placed = place_base(np.array([1.0, 2.0, 0.8]), tipped, ROBOT, height_m=0.8)
    np.testing.assert_allclose(placed.pos(np.array([1.0, 2.0, 0.8])), ROBOT.pos, atol=1e-12)
    # A point 0.5 m in front of their base, along world y, is 0.5 m in front of ours, along world x.
    in_front = placed.pos(np.array([1.0, 2.5, 0.82]))
    np.testing.assert_allclose(in_front, np.add(ROBOT.pos, (0.5, 0.0, 0.02)), atol=1e-5)
    np.testing.assert_allclose(np.abs(placed.rot(from_yaw(np.pi / 2))), [1, 0, 0, 0], atol=1e-5)


def test_velocities_turn_with_the_scene_and_spins_do_not():
    placed = Placement(from_yaw(np.pi / 2), np.zeros(3))
    state = placed.entity(
        np.zeros((1, 3)), [[2.0, 0, 0, 0]], lin_vel=[[1.0, 0, 0]], ang_vel=[[1.0, 0, 0]], joint_pos=[[0.5]]
    )
    np.testing.assert_allclose(state.lin_vel, [[0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(state.ang_vel, [[1, 0, 0]])
    np.testing.assert_allclose(state.rot, from_yaw(np.pi / 2)[None], atol=1e-12)
    with pytest.raises(DatasetError, match="not a unit quaternion"):
        placed.rot(np.zeros((1, 4)))


def rest(count):
    return EntityState.at_rest(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)))


def test_a_scene_is_assembled_with_the_targets_that_led_to_each_moment():
    qpos = np.tile(ROBOT.default_qpos, (3, 1))
    targets = np.add(qpos[:2], [[0.1], [0.2]])
    robot = assemble(ROBOT, qpos, targets, {"cube": rest(3)}).robots["franka"]
    np.testing.assert_allclose(robot.joint_target.numpy() - qpos, [[0] * 9, [0.1] * 9, [0.2] * 9], atol=1e-12)
    np.testing.assert_allclose(robot.pos, [ROBOT.pos] * 3)
    start_alone = assemble(ROBOT, qpos[:1], targets, {"cube": rest(1)}).robots["franka"]
    np.testing.assert_allclose(start_alone.joint_target, qpos[:1])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"objects": {"cube": rest(2)}}, "'objects/cube/pos' has 2 moments; the robot has 3"),
        ({"joint_vel": np.full((3, 9), np.nan)}, "'robots/franka/joint_vel' is not finite at moment 0"),
        ({"targets": np.zeros((0, 9))}, "Its actions are missing or not finite"),
        ({"targets": np.full((2, 9), np.inf)}, "Its actions are missing or not finite"),
    ],
)
def test_what_does_not_fit_is_refused(change, says):
    qpos = np.tile(ROBOT.default_qpos, (3, 1))
    values = {"targets": qpos[:2], "objects": {"cube": rest(3)}} | change
    with pytest.raises(DatasetError, match=says):
        assemble(ROBOT, qpos, **values)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([[1.0, 2.0]], r"Poses has the shape \(1, 2\); \(any, 3\) is needed"),
        ([["a", "b", "c"]], "Poses is not an array of numbers"),
        ([[1.0, 2.0, 3.0], [1.0, np.nan, 3.0]], "Poses is not finite at 1"),
        ([[1.0], [1.0, 2.0]], "Poses is not an array of numbers"),
    ],
)
def test_an_array_must_have_its_shape(values, says):
    with pytest.raises(DatasetError, match=says):
        array(values, (None, 3), "Poses")


def test_the_scene_must_be_that_of_the_task(tmp_path):
    scenes = {
        "Lift": SceneMapping("PickCube", {}, {"variant": "lift"}),
        "Nuts": SceneMapping("NutAssembly", {}, also=("PickCube",)),
    }
    goal = TASKS.get("PickCube")()
    lift = dataclasses.replace(goal, variant="lift")
    assert check_scene(tmp_path, "Lift", scenes, lift).task == "PickCube"
    assert check_scene(tmp_path, "Nuts", scenes, goal).task == "NutAssembly"
    with pytest.raises(DatasetError, match=r"Give task=PickCube task_kwargs\.variant=lift\."):
        check_scene(tmp_path, "Lift", scenes, goal)
    with pytest.raises(DatasetError, match=r"no registered task is the same.*Lift \(our PickCube\), Nuts"):
        check_scene(tmp_path, "PickPlace", scenes, goal)
