"""robosuite's operational-space control: by hand, and against robosuite's own functions."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.operational_space import (
    DELTA_M,
    DELTA_RAD,
    ArmDynamics,
    ArmModel,
    OperationalSpaceController,
    hand_torques,
)
from envs.robots.franka import FRANKA, FRANKA_TORQUE
from envs.scenario import ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks.tabletop import CONTROL_20_HZ

HOME = (0.0, -0.161037389, 0.0, -2.44459747, 0.0, 2.2267522, 0.7853981634, 0.04, 0.04)
ROBOT = FRANKA_TORQUE.with_home(HOME)
CLOSE, STAY, OPEN = 1.0, 0.0, -1.0


@pytest.fixture(scope="module")
def handler():
    settings = {"mujoco": {"integrator": "euler"}}
    with MujocoHandler(ScenarioCfg(robots=(ROBOT,), simulators=settings), 2, num_threads=1) as handler:
        handler.launch()
        yield handler


@pytest.fixture
def at_home(handler):
    state = handler.get_states()
    robot = state.robots["franka"]
    robot.joint_pos = torch.tensor([HOME] * 2, dtype=torch.float64)
    robot.joint_vel = torch.zeros((2, 9), dtype=torch.float64)
    robot.joint_target = None
    handler.set_states(state)
    return handler


def act(handler, action, steps, controller=None):
    """Both environments take the same action; returns the robot's state."""
    controller = controller or OperationalSpaceController(ROBOT)
    controller.begin(np.arange(2))
    for _ in range(steps):
        controller.advance(handler, np.tile(action, (2, 1)), 25)
    return handler.get_states().robots["franka"]


def test_a_mass_that_slides_is_driven_by_kp_times_its_way():
    """One joint along x: 2 kg, 0.1 m from the goal at 0.3 m/s, so F = 2 (150 · 0.1 - 2 √150 · 0.3) + 5 N."""
    jacobian = np.zeros((1, 6, 1))
    jacobian[0, 0, 0] = 1.0
    arm = ArmDynamics(
        np.zeros((1, 3)), np.eye(3)[None], jacobian, np.full((1, 1, 1), 2.0), np.full((1, 1), 5.0)
    )
    goal = np.array([[0.1, 0.0, 0.0]])
    torque = hand_torques(arm, goal, np.eye(3)[None], np.zeros((1, 1)), np.full((1, 1), 0.3))
    assert torque == pytest.approx(2.0 * (15.0 - 2.0 * np.sqrt(150.0) * 0.3) + 5.0)


def test_a_joint_that_does_not_move_the_hand_is_driven_to_its_posture():
    """Two slides, of which the hand has the first: the second gets 3 kg · 10 · 0.2 m, and damping."""
    jacobian = np.zeros((1, 6, 2))
    jacobian[0, 0, 0] = 1.0
    arm = ArmDynamics(
        np.zeros((1, 3)), np.eye(3)[None], jacobian, np.diag([2.0, 3.0])[None], np.zeros((1, 2))
    )
    error, speed = np.array([[0.4, 0.2]]), np.array([[0.0, 0.1]])
    torque = hand_torques(arm, np.zeros((1, 3)), np.eye(3)[None], error, speed)
    assert torque == pytest.approx(np.array([[0.0, 3.0 * (10.0 * 0.2 - 2.0 * np.sqrt(10.0) * 0.1)]]))


def test_a_turn_is_driven_by_its_sine_about_its_axis():
    """A hinge about z, 4 kg m², 30° from the goal: 4 · 150 · sin 30°."""
    jacobian = np.zeros((1, 6, 1))
    jacobian[0, 5, 0] = 1.0
    arm = ArmDynamics(np.zeros((1, 3)), np.eye(3)[None], jacobian, np.full((1, 1, 1), 4.0), np.zeros((1, 1)))
    goal = np.array([[[0.75**0.5, -0.5, 0.0], [0.5, 0.75**0.5, 0.0], [0.0, 0.0, 1.0]]])
    torque = hand_torques(arm, np.zeros((1, 3)), goal, np.zeros((1, 1)), np.zeros((1, 1)))
    assert torque == pytest.approx(4.0 * 150.0 * 0.5)


@pytest.mark.slow
def test_the_arm_moves_as_in_robosuite():
    """``robosuite_motion.json`` was recorded in LIBERO's own environment: 1,250 steps of physics."""
    motion = json.loads(Path(__file__).with_name("robosuite_motion.json").read_text())
    robot = dataclasses.replace(FRANKA_TORQUE, pos=tuple(motion["base"]))
    robot = robot.with_home((*motion["home"], 0.04, 0.04))
    settings = {"mujoco": {"integrator": "euler", "impratio": 20.0, "density": 1.2, "viscosity": 2e-5}}
    scenario = ScenarioCfg(robots=(robot,), table=None, physics=CONTROL_20_HZ, simulators=settings)
    controller = OperationalSpaceController(robot)
    with MujocoHandler(scenario, 1, num_threads=1) as alone:
        alone.launch()
        state = alone.get_states()
        start = torch.tensor([[*motion["start"], 0.04, 0.04]], dtype=torch.float64)
        state.robots["franka"].joint_pos, state.robots["franka"].joint_target = start, None
        alone.set_states(state)
        for step, action in enumerate(np.repeat(motion["actions"], motion["repeat"], axis=0), start=1):
            controller.advance(alone, action[None], 25)
            if str(step) in motion["joints"]:
                joints = alone.get_joint_positions("franka")[0, :7].numpy()
                np.testing.assert_allclose(joints, motion["joints"][str(step)], atol=1e-5, err_msg=str(step))


@pytest.mark.long  # robosuite compiles its functions, for 40 s
@pytest.mark.filterwarnings("ignore::SyntaxWarning", "ignore::DeprecationWarning", "ignore:np.dot")
def test_torques_are_those_of_robosuites_functions():
    from robosuite.utils import control_utils

    rng = np.random.default_rng(0)
    qpos = np.array([HOME]) + rng.normal(0, 0.2, (3, 9))
    qvel = rng.normal(0, 0.3, (3, 9))
    arm = ArmModel(ROBOT, 3).at(qpos, qvel)
    goal_pos = arm.pos + rng.normal(0, 0.03, (3, 3))
    goal_rot = arm.rot[[1, 2, 0]]
    error = np.array(HOME[:7]) - qpos[:, :7]
    ours = hand_torques(arm, goal_pos, goal_rot, error, qvel[:, :7])
    for row in range(3):
        jacobian, inertia = arm.jacobian[row], arm.inertia[row]
        velocity = jacobian @ qvel[row, :7]
        turn = control_utils.orientation_error(goal_rot[row], arm.rot[row])
        kp, kd = 150.0, 2.0 * np.sqrt(150.0)
        _, mass, turned, null = control_utils.opspace_matrices(
            inertia, jacobian, np.ascontiguousarray(jacobian[:3]), np.ascontiguousarray(jacobian[3:])
        )
        force = mass @ (kp * (goal_pos[row] - arm.pos[row]) - kd * velocity[:3])
        wrench = np.concatenate([force, turned @ (kp * turn - kd * velocity[3:])])
        kept = control_utils.nullspace_torques(
            inertia, null, np.array(HOME[:7]), qpos[row, :7], qvel[row, :7]
        )
        np.testing.assert_allclose(ours[row], jacobian.T @ wrench + arm.bias[row] + kept, rtol=1e-9)


def test_an_action_of_zero_holds_the_arm_against_gravity(at_home):
    before = at_home.get_states().robots["franka"].ee_pos.clone()
    after = act(at_home, OperationalSpaceController(ROBOT).hold(at_home.get_states())[0], 20)
    assert (after.ee_pos - before).norm(dim=-1).max() < 1e-4
    torch.testing.assert_close(after.joint_pos[:, 7:], torch.full((2, 2), 0.04).double(), atol=1e-3, rtol=0)


@pytest.mark.parametrize("axis", range(3))
def test_the_hand_goes_along_the_worlds_axis_and_no_faster_than_its_goals(at_home, axis):
    """Each of 8 goals is 5 cm ahead of where the hand is."""
    action = np.zeros(7)
    action[axis] = 1.0
    before = at_home.get_states().robots["franka"].ee_pos.clone()
    controller = OperationalSpaceController(ROBOT)
    middle = act(at_home, action, 8, controller).ee_pos.clone()
    way = (middle - before).numpy()[0]
    assert 0.1 < way[axis] < 8 * DELTA_M
    assert np.abs(np.delete(way, axis)).max() < 0.1 * way[axis]


def test_the_gripper_moves_in_even_steps_and_stops_at_zero(at_home):
    shut = act(at_home, np.array([0, 0, 0, 0, 0, 0, CLOSE]), 4).joint_target[0, 7:]
    torch.testing.assert_close(shut, torch.full((2,), 0.04 - 4 * 25 * 0.0002).double())
    kept = act(at_home, np.array([0, 0, 0, 0, 0, 0, STAY]), 1).joint_target[0, 7:]
    torch.testing.assert_close(kept, shut)
    wide = act(at_home, np.array([0, 0, 0, 0, 0, 0, OPEN]), 8).joint_target[0, 7:]
    torch.testing.assert_close(wide, torch.full((2,), 0.04).double())


def test_a_turn_of_zero_keeps_the_former_goal_until_the_next_episode(at_home):
    controller = OperationalSpaceController(ROBOT)
    turn = np.zeros(7)
    turn[5] = 1.0
    act(at_home, turn, 1, controller)
    goal = controller._goal_rot.copy()
    controller.advance(at_home, np.zeros((2, 7)), 25)
    assert (controller._goal_rot == goal).all()
    cosine = np.trace(goal[0].T @ at_home_rot(at_home), axis1=0, axis2=1)
    assert np.arccos((cosine - 1) / 2) < DELTA_RAD, "the hand goes on turning towards it"
    controller.begin(np.array([1]))
    controller.advance(at_home, np.zeros((2, 7)), 25)
    assert (controller._goal_rot[0] == goal[0]).all() and not (controller._goal_rot[1] == goal[1]).all()


def at_home_rot(handler):
    robot = handler.get_states().robots["franka"]
    return ArmModel(ROBOT, 2).at(robot.joint_pos.numpy(), robot.joint_vel.numpy()).rot[0]


def test_environments_that_are_stepped_alone_do_as_all_together(at_home):
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (3, 2, 7))
    start = at_home.get_states()
    start = dataclasses.replace(start) if dataclasses.is_dataclass(start) else start
    controller = OperationalSpaceController(ROBOT)
    for action in actions:
        controller.advance(at_home, action, 25)
    together = at_home.get_states().robots["franka"].joint_pos.clone()
    at_home.set_states(start)
    controller = OperationalSpaceController(ROBOT)
    for action in actions:
        for env_id in (1, 0):
            controller.advance(at_home, action[env_id : env_id + 1], 25, np.array([env_id]))
    torch.testing.assert_close(at_home.get_states().robots["franka"].joint_pos, together, atol=1e-9, rtol=0)


def test_actions_beyond_their_range_are_clipped(at_home):
    start = at_home.get_states()
    one = act(at_home, np.full(7, 1.0), 2).joint_pos.clone()
    at_home.set_states(start)
    assert torch.equal(act(at_home, np.full(7, 5.0), 2).joint_pos, one)


def test_a_robot_that_is_driven_to_positions_is_refused():
    with pytest.raises(
        ConfigError, match="'franka' is not such a robot: give its arm's joints drive='torque'"
    ):
        OperationalSpaceController(FRANKA)
