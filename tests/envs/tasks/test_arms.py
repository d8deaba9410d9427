"""Several arms: how they wait for each other, what their hands' waypoints are, and what names they get."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.controllers import HandDeltaController, JoinedController, JointPositionController
from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint, interpolate
from envs.robots import ROBOTS
from envs.rotations import from_yaw, rotate
from envs.scenario import ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState
from envs.tasks.arm_at_table import chain_at_rest
from envs.tasks.arms import Hand, downward, in_world, pointing
from envs.tasks.arms_planner import ArmsPlanner, scheduled, steps_of
from envs.tasks.make import make_task
from envs.tasks.maniskill.two_robots import LEFT, RIGHT, TwoRobotPickCube, TwoRobotStackCube
from envs.tasks.pick_cube import PickCube
from envs.tasks.workspace import TaskWorkspace

HZ = 20.0
TASK = TwoRobotPickCube()


def way(duration_s, hold_s=0.0, gripper=0.04, x=0.0):
    return Waypoint(
        pos=np.array([x, 0.0, 0.2]), yaw=0.0, gripper=gripper, duration_s=duration_s, hold_s=hold_s
    )


def test_steps_are_those_of_the_path():
    ways = [way(0.5, 0.2), way(0.01), way(1.0)]
    start = way(0.0)
    assert steps_of(ways, HZ) == len(interpolate(start, ways, HZ).pos) == 10 + 4 + 1 + 20


def test_who_is_early_waits_at_its_last_waypoint_and_who_is_absent_stays():
    phases = [{"a": [way(0.5)]}, {"a": [way(0.25)], "b": [way(1.0), way(0.5, 0.1)]}, {"b": [way(0.3)]}]
    arms = scheduled(phases, ("a", "b"), HZ)
    assert (arms["a"].wait, arms["b"].wait) == (0, 10)
    assert [steps_of([one], HZ) for one in arms["a"].ways] == [10, 5 + 27 + 6]
    assert [steps_of([one], HZ) for one in arms["b"].ways] == [20, 12, 6]
    assert {arm.wait + steps_of(arm.ways, HZ) for arm in arms.values()} == {10 + 32 + 6}


def test_arms_that_do_nothing_have_an_empty_plan():
    arms = scheduled([], ("a",), HZ)
    assert arms["a"].wait == 0 and arms["a"].ways == ()


@pytest.fixture(scope="module")
def two():
    with MujocoHandler(ScenarioCfg(robots=(LEFT, RIGHT)), 2, num_threads=1) as handler:
        handler.launch()
        yield handler


@pytest.mark.slow
def test_one_arm_moves_while_the_other_waits_and_then_both_at_once(two):
    def phases(state, _):
        left, right = (Hand(state.robots[robot.name], robot) for robot in (LEFT, RIGHT))
        lower = [hand.to(hand.pos - [0, 0, 0.1], hand.rot, 0.04, 0.5) for hand in (left, right)]
        raised = left.to(left.pos, left.rot, 0.0, 0.5)
        return [{left.name: lower[:1]}, {left.name: [raised], right.name: lower[1:]}]

    state, rng = two.get_states(), np.random.default_rng(0)
    planner = ArmsPlanner((LEFT, RIGHT), HZ, phases)
    plan = planner.plan(state.select([0]), rng)
    assert plan.shape == (20, 18) and plan.dtype == np.float32
    for batched in planner.plan_batch(state, [rng, rng]):
        np.testing.assert_allclose(batched, plan, atol=2e-3)
    for exact in planner.plan_each(state, [rng, rng]):
        np.testing.assert_array_equal(exact, plan)
    assert (plan[:10, 9:] == plan[0, 9:]).all() and np.abs(plan[10:, 9:] - plan[0, 9:]).max() > 0.05
    controller = TASK.controller
    starts = [state.robots[robot.name].ee_pos.clone() for robot in (LEFT, RIGHT)]
    for targets in plan:
        controller.advance(two, torch.from_numpy(targets).repeat(2, 1), 25)
    ends = [two.get_states().robots[robot.name].ee_pos for robot in (LEFT, RIGHT)]
    np.testing.assert_allclose(ends[0] - starts[0], np.zeros((2, 3)), atol=0.01)
    np.testing.assert_allclose(ends[1] - starts[1], [[0, 0, -0.1]] * 2, atol=0.01)


def test_an_action_of_two_robots_is_theirs_one_after_the_other(two):
    controller = TASK.controller
    parts = [JointPositionController(robot) for robot in (LEFT, RIGHT)]
    assert controller.names == tuple(
        f"{robot.name}/{name}"
        for robot, part in zip((LEFT, RIGHT), parts, strict=True)
        for name in part.names
    )
    np.testing.assert_array_equal(controller.low, np.concatenate([part.low for part in parts]))
    state = two.get_states()
    np.testing.assert_array_equal(
        controller.hold(state), np.concatenate([part.hold(state) for part in parts], axis=1)
    )
    targets = controller.joint_targets(two, np.arange(36.0).reshape(2, 18))
    np.testing.assert_array_equal(targets[RIGHT.name], np.arange(36.0).reshape(2, 18)[:, 9:])


def test_hands_of_two_robots_move_by_their_own_deltas(two):
    controller = TASK.rl_controller
    assert isinstance(controller, JoinedController) and len(controller.names) == 10
    actions = np.zeros((2, 10))
    actions[:, 2], actions[:, 7] = 1.0, -1.0  # the left hand up, the right one down
    state = two.get_states()
    alone = HandDeltaController(RIGHT).as_task_actions(state, actions[:, 5:])
    np.testing.assert_array_equal(controller.as_task_actions(state, actions)[:, 9:], alone)
    assert np.abs(controller.as_task_actions(state, actions)[:, :7] - alone[:, :7]).max() > 0.01


def test_names_and_state_of_a_policy_have_every_robot():
    state = TASK.initial_state([np.random.default_rng(row) for row in range(3)])
    both = [state.robots[robot.name].joint_pos for robot in (LEFT, RIGHT)]
    assert torch.equal(TASK.proprioception(state), torch.cat(both, 1))
    assert TASK.state_names[:1] + TASK.state_names[9:10] == ("franka_left/joint1", "franka_right/joint1")
    assert len(TASK.state_names) == len(TASK.state_limits[0]) == 18
    assert not torch.equal(*both), "each arm draws its own start"


def test_names_of_one_robot_are_as_its_file_has_them():
    task = PickCube()
    assert task.robots == (task.robot,) and task.state_names == task.robot.joint_names
    assert isinstance(task.controller, JointPositionController)


def test_each_robot_has_a_wrist_camera():
    cameras = {camera.name: camera.mount for camera in TASK.scenario.cameras}
    assert cameras["wrist_franka_left"] == "franka_left/right_hand"
    assert cameras["wrist_franka_right"] == "franka_right/right_hand"


def test_a_changed_scene_keeps_both_robots():
    task = make_task("TwoRobotPickCube", scenario={"robots": {"franka_right": {"pos": [0.0, 0.8, 0.0]}}})
    assert [robot.pos[1] for robot in task.robots] == [-0.75, 0.8]
    assert task.scenario.robots == task.robots and len(task.controller.names) == 18


def test_several_robots_are_refused_where_one_is_needed():
    with pytest.raises(ConfigError, match="franka_left and franka_right act together"):
        make_task("TwoRobotPickCube", robot="ur5e")
    with pytest.raises(ConfigError, match="A channel that changes starts takes a task of one robot"):
        TaskWorkspace(TASK)


def hand(robot, pos=(0.0, 0.0, 0.3)):
    entity = EntityState.at_rest(np.array(robot.pos), np.array([robot.rot]))
    rest = chain_at_rest(robot)[1]
    return Hand(
        dataclasses.replace(entity, ee_pos=torch.tensor([pos]), ee_rot=torch.from_numpy(rest)[None]), robot
    )


@pytest.mark.parametrize("robot", [LEFT, RIGHT], ids=lambda robot: robot.name)
def test_a_waypoint_at_rest_turns_nothing_whichever_way_the_robot_faces(robot):
    own = hand(robot)
    there = own.to(own.pos, own.rot, 0.04, 1.0)
    np.testing.assert_allclose(there.turn, 0.0, atol=1e-6)
    np.testing.assert_allclose(rotate(own.rot, np.array([0.0, 0.0, 1.0])), [0, 0, -1], atol=1e-4)


def test_a_hand_points_and_opens_where_it_should():
    rot = pointing((0.0, 0.3, -1.0), (1.0, 0.0, 0.0))
    np.testing.assert_allclose(rotate(rot, np.array([1.0, 0.0, 0.0])), [1, 0, 0], atol=1e-9)
    forward = rotate(rot, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(forward[1:] / forward[2], [-0.3, 1.0], atol=1e-9)
    opening = rotate(downward(0.7), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(opening, [np.cos(0.7), np.sin(0.7), 0.0], atol=1e-9)


def test_fingers_are_exchanged_where_that_turns_less():
    own = hand(LEFT)
    flipped = downward(np.pi / 2 + 0.2)  # the left robot's fingers open along x at rest
    for rot in (downward(0.2), downward(np.pi + 0.2), flipped):
        assert abs(own.to(own.pos, own.nearer(rot), 0.0, 1.0).yaw) <= np.pi / 2 + 1e-6


def test_a_point_of_an_entity_turns_with_it():
    entity = EntityState.at_rest(np.array([1.0, 0.0, 0.5]), from_yaw(np.array([np.pi / 2])))
    np.testing.assert_allclose(in_world(entity, (0.1, 0.0, 0.2)), [1.0, 0.1, 0.7], atol=1e-9)


def with_arms(task, *arms):
    """The class of a task of two arms that other arms do, at the same places, under names of their own."""
    robots = tuple(
        dataclasses.replace(ROBOTS.get(arm), name=name, pos=each.pos, rot=each.rot)
        for arm, name, each in zip(arms, ("one", "other"), (LEFT, RIGHT), strict=True)
    )
    return type(task.__name__, (task,), {"own_robots": robots, "__slots__": ()})


def test_rules_and_rewards_read_the_arms_of_the_task():
    # The 2F-85 of one arm has six joints, of which one is driven; the UR5e has six joints of its own.
    for cls in (TwoRobotPickCube, TwoRobotStackCube):
        task = with_arms(cls, "iiwa_2f85", "ur5e")()
        state = task.initial_state([np.random.default_rng(row) for row in range(3)])
        for robot, y in zip(task.robots, (-0.4, 0.4), strict=True):
            entity = state.robots[robot.name]
            entity.ee_pos = torch.tensor([[0.0, y, 0.3]]).repeat(3, 1).double()
            entity.joint_target = entity.joint_pos[:, list(robot.driven)].clone()
        assert task.success(state).tolist() == [False] * 3
        assert ((task.reward(state) > 0.0) & (task.reward(state) < 1.0)).all()
    task = with_arms(TwoRobotPickCube, "iiwa_2f85", "ur5e")()
    state.objects["goal"], state.objects["cube"] = state.objects["cube_a"], state.objects["cube_a"]
    state.robots["one"].joint_vel[:] = 1.0  # the left arm may move, and so may the right one's fingers
    state.robots["other"].joint_vel[0, 6], state.robots["other"].joint_vel[1, 5] = 0.3, 0.3
    assert task.success(state).tolist() == [True, False, True]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cls", "arms", "sizes"),
    [
        # Hands with four joints more than the Franka's, five of which follow the one that is driven.
        (TwoRobotPickCube, ("iiwa_2f85", "iiwa_2f85"), (8, 8)),
        (TwoRobotPickCube, ("iiwa_2f85", "ur5e"), (8, 8)),
        (TwoRobotStackCube, ("franka", "ur5e_2f85"), (9, 7)),
    ],
    ids=["two_2f85", "mixed", "mixed_stack"],
)
def test_experts_work_with_other_arms_and_hands(cls, arms, sizes):
    task = with_arms(cls, *arms)()
    assert len(task.controller.names) == sum(sizes)
    with MujocoHandler(task.scenario, 2, num_threads=1) as handler:
        handler.launch()
        rngs = [np.random.default_rng(row) for row in range(2)]
        handler.set_states(task.initial_state(rngs))
        solved = torch.zeros(2, dtype=torch.bool)
        plans = task.planner.plan_batch(handler.get_states(), rngs)
        assert [plan.shape[1] for plan in plans] == [sum(sizes)] * 2
        for step in range(max(map(len, plans))):
            now = np.stack([plan[min(step, len(plan) - 1)] for plan in plans])
            task.controller.advance(handler, torch.from_numpy(now), 25)
            solved |= task.success(handler.get_states())
        assert solved.all()
