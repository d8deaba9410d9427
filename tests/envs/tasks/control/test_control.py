"""Cartpole, ant and Franka reach: Isaac Lab's terms, written out by hand."""

import math

import mujoco
import numpy as np
import pytest
import torch
from scipy import linalg

from envs.core.errors import ConfigError
from envs.kinematics.batched_inverse import BatchedInverseKinematics
from envs.kinematics.forward import rotation_vector
from envs.mjcf.drives import rest_targets
from envs.mjcf.model import build_model
from envs.robots.ant import ANT
from envs.rotations import to_matrix
from envs.scenario import JointCfg, RobotCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState, State
from envs.tasks import TASKS
from envs.tasks.control import reach

NAMES = ("cartpole", "ant", "franka_reach")
STEP_S = 1 / 60
ROWS = 4


def task_of(name):
    return TASKS.get(f"control/{name}")()


@pytest.fixture(scope="module", params=NAMES)
def task(request):
    return task_of(request.param)


@pytest.fixture(scope="module")
def recorded():
    """Makes states of random actions, once for each task."""
    known = {}

    def make(name):
        if name not in known:
            task, rng = task_of(name), np.random.default_rng(0)
            with MujocoHandler(task.scenario, ROWS, num_threads=1) as handler:
                handler.launch()
                handler.set_states(task.initial_state([np.random.default_rng(i) for i in range(ROWS)]))
                for _ in range(8):
                    actions = rng.uniform(-1, 1, (ROWS, len(task.controller.names)))
                    task.controller.advance(handler, actions, task.scenario.physics.decimation)
                states = handler.get_states()
            known[name] = State.unflatten(states.flatten())
        return known[name]

    return make


def cartpole_at(angle, cart=0.0, speeds=(0.0, 0.0)):
    robot = EntityState.at_rest(np.zeros((1, 3)), np.array([1.0, 0, 0, 0]), np.array([[cart, angle]]))
    robot.joint_vel = torch.tensor([speeds], dtype=torch.float64)
    return State({"cartpole": robot}, {})


@pytest.mark.parametrize("turns", [0, 1, -2])
def test_cartpole_reward_depends_on_angle_and_speed(turns):
    state = cartpole_at(0.3 + turns * 2 * math.pi, 1.0, (2.0, -3.0))
    expected = STEP_S * (1.0 - 0.3**2 - 0.01 * 2.0 - 0.005 * 3.0)
    assert task_of("cartpole").reward(state).item() == pytest.approx(expected)


def test_leaving_the_rail_is_a_failure_with_a_penalty():
    task, state = task_of("cartpole"), cartpole_at(0.0, 3.1)
    assert task.failure(state).tolist() == [True]
    assert task.reward(state).item() == pytest.approx(STEP_S * -2.0)
    assert not task.failure(cartpole_at(2.0, -2.9)).any()


def regulator(model, steps):
    """The linear-quadratic regulator of the upright pole, from MuJoCo's own derivatives, (4,)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    one, push = np.zeros((4, 4)), np.zeros((4, 1))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, one, push, None, None)
    a, b = np.eye(4), np.zeros((4, 1))
    for _ in range(steps):
        a, b = one @ a, one @ b + push
    cost = linalg.solve_discrete_are(a, b, np.diag([1.0, 10.0, 0.1, 0.1]), np.array([[1e-4]]))
    return np.linalg.solve(1e-4 + b.T @ cost @ b, b.T @ cost @ a)[0]


def test_a_pole_that_is_kept_upright_reaches_the_bar():
    task = task_of("cartpole")
    count = 20
    with MujocoHandler(task.scenario, count, num_threads=1) as handler:
        handler.launch()
        handler.set_states(task.initial_state([np.random.default_rng(i) for i in range(count)]))
        returns = torch.zeros(count, dtype=torch.float64)
        gains = regulator(handler.model, task.scenario.physics.decimation) / 100.0
        for _ in range(task.max_episode_steps):
            seen = task.observe(handler.get_states()).numpy()
            action = -seen @ gains
            task.controller.advance(handler, action[:, None], task.scenario.physics.decimation)
            returns += task.reward(handler.get_states())
    assert (returns >= task.success_return).all()
    assert returns.max() <= 5.0


def test_ant_reward_is_the_sum_of_its_terms(recorded):
    state = recorded("ant")
    robot = state.robots["ant"]
    reward = task_of("ant").reward(state)
    for row in range(ROWS):
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, robot.rot[row].numpy())
        matrix = matrix.reshape(3, 3)
        way = np.array([1000.0, 0.0]) - robot.pos[row, :2].numpy()
        way /= np.linalg.norm(way)
        heading = matrix[:2, 0] @ way
        action = robot.joint_target[row].numpy() / 7.5
        low, high = np.array([joint.range for joint in ANT.joints]).T
        near = np.abs(2 * (robot.joint_pos[row].numpy() - low) / (high - low) - 1)
        limits = sum(max(0.0, value - 0.99) / 0.01 for value in near)
        terms = (
            1.0 * robot.lin_vel[row, :2].numpy() @ way,
            0.5 * (robot.pos[row, 2] >= 0.31).item(),
            0.1 * (matrix[2, 2] > 0.93),
            0.5 * (1.0 if heading > 0.8 else heading / 0.8),
            -0.005 * (action**2).sum(),
            -0.05 * np.abs(action * robot.joint_vel[row].numpy()).sum(),
            -0.1 * limits,
        )
        assert reward[row].item() == pytest.approx(STEP_S * sum(terms)), row


def test_an_ant_sees_itself_in_its_own_frame(recorded):
    state = recorded("ant")
    robot, seen = state.robots["ant"], task_of("ant").observe(state)
    assert seen.shape == (ROWS, 36)
    assert torch.equal(seen[:, 0], robot.pos[:, 2])
    for row in range(ROWS):
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, robot.rot[row].numpy())
        np.testing.assert_allclose(
            seen[row, 1:4], matrix.reshape(3, 3).T @ robot.lin_vel[row].numpy(), atol=1e-9
        )
    assert torch.equal(seen[:, 28:], robot.joint_target / 7.5)


def test_reach_reward_has_both_errors(recorded):
    state, task = recorded("franka_reach"), task_of("franka_reach")
    robot, goal = state.robots["franka"], state.objects["goal"]
    reward, seen = task.reward(state), task.observe(state)
    assert seen.shape == (ROWS, 32)
    for row in range(ROWS):
        off = np.linalg.norm((robot.ee_pos[row] - goal.pos[row]).numpy())
        overlap = abs(float((robot.ee_rot[row] * goal.rot[row]).sum()))
        turn = 2 * math.acos(min(1.0, overlap))
        speeds = float((robot.joint_vel[row] ** 2).sum())
        terms = -0.2 * off + 0.1 * (1 - math.tanh(off / 0.1)) - 0.1 * turn - 0.0001 * speeds
        assert reward[row].item() == pytest.approx(terms / 30)
    state.robots["franka"].ee_pos, state.robots["franka"].ee_rot = goal.pos.clone(), goal.rot.clone()
    assert task.success(state).all()
    state.robots["franka"].ee_pos = goal.pos + 0.06
    assert not task.success(state).any()


@pytest.mark.slow
def test_every_command_has_a_posture_that_an_action_can_ask_for():
    """Newton's method from some starts finds one within the bounds of an action, for each of 32 commands."""
    rngs = [np.random.default_rng(i) for i in range(32)]
    task = task_of("franka_reach")
    goal = task.initial_state(rngs).objects["goal"]
    pos, rot = goal.pos.double(), torch.as_tensor(to_matrix(goal.rot.numpy()))
    inverse = BatchedInverseKinematics(reach.ROBOT)
    low = torch.maximum(inverse.chain.low, inverse.rest - reach.ACTION_RAD)
    high = torch.minimum(inverse.chain.high, inverse.rest + reach.ACTION_RAD)
    inverse.chain.low, inverse.chain.high = low, high
    generator = torch.Generator().manual_seed(0)
    reached = torch.zeros(32, dtype=torch.bool)
    for _ in range(16):
        q = low + (high - low) * torch.rand(32, 7, generator=generator, dtype=torch.float64)
        for _ in range(60):
            q = q + inverse.change(q, inverse.chain(q), pos, rot)
        now = inverse.chain(q)
        turn = rotation_vector(rot @ now.rot.transpose(1, 2)).norm(dim=-1)
        reached |= ((now.pos - pos).norm(dim=-1) <= task.near_m) & (turn <= task.near_rad)
    assert reached.all()


def test_a_hand_that_points_down_is_what_is_commanded():
    """The z axis of a command points down, as the hand's does in the maker's ready posture."""
    task = task_of("franka_reach")
    state = task.initial_state([np.random.default_rng(0)])
    ready = [0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4, 0.04, 0.04]
    state.robots["franka"].joint_pos[:] = torch.tensor(ready)
    with MujocoHandler(task.scenario, 1, num_threads=1) as handler:
        handler.launch()
        handler.set_states(state)
        hand = handler.get_states().robots["franka"].ee_rot[0].numpy()
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, hand)
    assert matrix[8] < -0.999
    mujoco.mju_quat2Mat(matrix, state.objects["goal"].rot[0].numpy())
    assert matrix[8] < -0.999


def test_starts_fill_their_ranges():
    rngs = [np.random.default_rng(i) for i in range(200)]
    cart = task_of("cartpole").initial_state(rngs).robots["cartpole"]
    values = torch.cat((cart.joint_pos, cart.joint_vel), -1).abs().amax(0)
    half = torch.tensor([1.0, math.pi / 4, 0.5, math.pi / 4], dtype=torch.float64)
    assert ((values <= half) & (values > 0.9 * half)).all()
    ant = task_of("ant").initial_state(rngs).robots["ant"]
    off = (ant.joint_pos - torch.tensor(ANT.default_qpos)).abs()
    assert 0.19 < off.max() <= 0.2
    goal = task_of("franka_reach").initial_state(rngs).objects["goal"].pos
    assert (goal.amin(0) >= torch.tensor([0.35, -0.2, 0.15])).all()
    assert (goal.amax(0) <= torch.tensor([0.65, 0.2, 0.5])).all()


@pytest.mark.parametrize("name", ["cartpole", "ant"])
def test_an_action_of_one_is_the_published_effort(name):
    task, effort = task_of(name), {"cartpole": 100.0, "ant": 7.5}[name]
    with MujocoHandler(task.scenario, 1, num_threads=1) as handler:
        handler.launch()
        robot = task.scenario.robots[0].name
        assert not handler.get_states().robots[robot].joint_target.any()
        task.controller.apply(handler, np.ones((1, len(task.controller.names))))
        data = mujoco.MjData(handler.model)
        data.ctrl[:] = handler._ctrl[0]
        mujoco.mj_forward(handler.model, data)
        np.testing.assert_allclose(data.actuator_force, effort)


def test_the_ants_numbers_are_isaac_gyms():
    model = build_model(task_of("ant").scenario)
    joint = model.joint("ant/ankle_2")
    np.testing.assert_allclose(joint.range, np.radians([-100.0, -30.0]))
    assert (joint.damping[0], joint.armature[0]) == (0.1, 0.01)
    assert model.body_mass.sum() == pytest.approx(0.911, abs=1e-3)


def test_a_torque_needs_a_range_and_no_gain():
    given = {
        "name": "j",
        "kd": 0.0,
        "force_limit": 1.0,
        "range": (-1.0, 1.0),
        "default": 0.5,
        "drive": "torque",
    }
    for wrong in ({"kp": 0.0}, {"kp": 1.0, "target_range": (-1.0, 1.0)}):
        with pytest.raises(ConfigError, match="'j' is driven by a torque, so it needs a target_range"):
            JointCfg(**given, **wrong)
    joint = JointCfg(**given, kp=0.0, target_range=(-1.0, 1.0))
    assert rest_targets(RobotCfg(name="r", mjcf="", root="", ee_site="", joints=(joint,))) == 0.0


@pytest.mark.parametrize("name", NAMES)
def test_no_constant_stays_on_the_cpu(name, recorded):
    task, state = task_of(name), recorded(name).to("meta", torch.float32)
    for function in (task.reward, task.failure, task.success, task.observe):
        assert function(state).device.type == "meta"


@pytest.mark.parametrize("name", NAMES)
def test_what_an_agent_sees_is_what_is_observed(name, recorded):
    task, state = task_of(name), recorded(name)
    assert torch.equal(task.rl_observation(state), task.observe(state))
    assert (task.rl_controller.low == -1.0).all()
