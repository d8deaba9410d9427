"""Stand, walk and run against HumanoidBench's own model and numbers."""

import mujoco
import numpy as np
import pytest
import torch

import envs
from envs.mjcf.model import build_model
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import State
from envs.tasks import TASKS
from tests.envs.tasks.humanoid.published import ASSETS, Published, needs_assets, published_model, put

NAMES = ("stand", "walk", "run")


@pytest.fixture(scope="module")
def published():
    return published_model()


@pytest.fixture(scope="module")
def ours():
    """Compiled scenes: with the package's robot, and with HumanoidBench's own."""
    walk = TASKS.get("humanoid/walk")
    return {
        name: build_model(walk(model=model).scenario)
        for name, model in (("package", ""), ("own", str(ASSETS)))
    }


@pytest.fixture(scope="module")
def recorded():
    """States of random actions, from the start to lying on the ground: every tenth of a second."""
    task = TASKS.get("humanoid/walk")()
    rng = np.random.default_rng(0)
    with MujocoHandler(task.scenario, 2, num_threads=1) as handler:
        handler.launch()
        handler.set_states(task.initial_state([np.random.default_rng(i) for i in range(2)]))
        states = [handler.get_states()]
        for _ in range(12):
            task.controller.apply(handler, rng.uniform(-0.5, 0.5, (2, 19)))
            handler.step(50)
            states.append(handler.get_states())
    flat = [state.flatten() for state in states]
    return State.unflatten({key: torch.cat([values[key] for values in flat]) for key in flat[0]})


def joint_names(model):
    return [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, index) for index in range(1, model.njnt)]


@needs_assets
@pytest.mark.parametrize("source", ["package", "own"])
def test_masses_and_inertias_are_the_published_ones(source, ours, published):
    model = ours[source]
    compared = 0
    for index in range(1, published.nbody):
        reference = published.body(index)
        if reference.mass[0] == 0.0:  # the hands, which are places
            continue
        body = model.body(f"h1/{reference.name}")
        compared += 1
        for field in ("mass", "ipos", "inertia"):
            np.testing.assert_allclose(getattr(body, field), getattr(reference, field), atol=1e-7)
        assert abs(np.dot(body.iquat, reference.iquat)) == pytest.approx(1.0, abs=1e-9)
    assert compared == 20
    assert model.body_mass.sum() == pytest.approx(published.body_mass.sum())


@needs_assets
@pytest.mark.parametrize("source", ["package", "own"])
def test_joints_and_actuators_are_the_published_ones(source, ours, published):
    model, walk = ours[source], TASKS.get("humanoid/walk")
    robot = walk(model=str(ASSETS) if source == "own" else "").robot
    assert (model.nq, model.nv, model.nu) == (published.nq, published.nv, published.nu) == (26, 25, 19)
    for name, reference in zip(robot.joint_names, joint_names(published), strict=True):
        assert reference in name.replace("_leg", "")
        joint, own = model.joint(f"h1/{name}"), published.joint(reference)
        for field in ("axis", "range", "damping", "armature", "frictionloss", "stiffness", "limited"):
            np.testing.assert_array_equal(getattr(joint, field), getattr(own, field), field)
        actuator, servo = model.actuator(f"h1/{name}"), published.actuator(reference)
        for field in ("gainprm", "biasprm", "ctrlrange", "forcerange", "gear"):
            np.testing.assert_allclose(getattr(actuator, field), getattr(servo, field), err_msg=field)


@needs_assets
def test_the_solver_is_the_published_one(ours, published):
    for model in ours.values():
        for field in ("timestep", "integrator", "cone", "iterations", "ls_iterations", "impratio", "solver"):
            assert getattr(model.opt, field) == getattr(published.opt, field), field
        floor, ground = published.geom("floor"), model.geom("ground")
        for field in ("friction", "solref", "solimp", "condim"):
            np.testing.assert_array_equal(getattr(ground, field), getattr(floor, field))


@needs_assets
def test_the_posture_of_the_start_is_the_published_keyframe(published):
    robot = TASKS.get("humanoid/walk")().robot
    np.testing.assert_allclose(published.key_qpos[0], [*robot.pos, *robot.rot, *robot.default_qpos])


@needs_assets
@pytest.mark.parametrize("name", NAMES)
def test_rewards_are_those_written_out_by_hand(name, recorded, published):
    task, data = TASKS.get(f"humanoid/{name}")(), mujoco.MjData(published)
    reward = task.reward(recorded)
    for row in range(recorded.num_envs):
        put(published, data, recorded.select([row]))
        assert reward[row].item() == pytest.approx(Published(data).reward(name), abs=1e-9), row
    assert reward.max() > 0.05
    assert reward.min() < 0.01


@needs_assets
def test_the_observation_is_qpos_and_qvel(recorded, published):
    data = mujoco.MjData(published)
    seen = TASKS.get("humanoid/walk")().observe(recorded)
    assert seen.shape == (recorded.num_envs, 51)
    for row in (0, 7):
        put(published, data, recorded.select([row]))
        np.testing.assert_array_equal(seen[row], [*data.qpos, *data.qvel])


@needs_assets
def test_its_own_robot_moves_as_published(published):
    """Half a second of the same actions, standing and falling: the same motion to rounding."""
    task = TASKS.get("humanoid/walk")(model=str(ASSETS))
    actions = np.random.default_rng(2).uniform(-0.3, 0.3, (25, 19))
    low, high = published.actuator_ctrlrange.T
    data = mujoco.MjData(published)
    with MujocoHandler(task.scenario, 1, num_threads=1) as handler:
        handler.launch()
        handler.set_states(task.initial_state([np.random.default_rng(0)]))
        put(published, data, handler.get_states())
        data.qacc_warmstart[:] = 0.0
        for action in actions:
            task.controller.apply(handler, action[None])
            handler.step(10)
            data.ctrl[:] = low + (action + 1.0) / 2.0 * (high - low)
            mujoco.mj_step(published, data, 10)
        seen = task.observe(handler.get_states())[0]
    np.testing.assert_allclose(seen, [*data.qpos, *data.qvel], atol=1e-3)


def test_a_fall_is_a_failure_and_no_success(recorded):
    task = TASKS.get("humanoid/walk")()
    failed = task.failure(recorded)
    assert not failed[0]
    assert torch.equal(failed, recorded.robots["h1"].pos[:, 2] < 0.2)
    assert not task.success(recorded).any()


@pytest.mark.slow
def test_steps_are_rewarded_and_the_return_decides_success(monkeypatch):
    stand = TASKS.get("humanoid/stand")
    monkeypatch.setattr(stand, "max_episode_steps", 3)
    for bar, enough in ((0.5, True), (3.0, False)):
        monkeypatch.setattr(stand, "success_return", bar)
        env = envs.make_vec("humanoid/stand", 1, split="train", observation="state")
        env.reset(seed=0)
        results = [env.step(np.zeros((1, 19))) for _ in range(3)]
        assert [result[3].item() for result in results] == [False, False, True]
        assert [result[4]["is_success"].item() for result in results] == [False, False, enough]
        env.close()


def test_starts_are_the_posture_with_noise_of_a_hundredth():
    task = TASKS.get("humanoid/walk")()
    state = task.initial_state([np.random.default_rng(i) for i in range(64)]).robots["h1"]
    robot = task.robot
    for values, rest in ((state.pos, robot.pos), (state.joint_pos, robot.default_qpos)):
        off = values - torch.tensor(rest, dtype=torch.float64)
        assert off.abs().max() <= 0.01
        assert off.abs().max() > 0.009
        assert (off.std(0) > 0.003).all()
    assert torch.allclose(torch.linalg.vector_norm(state.rot, dim=-1), torch.ones(64, dtype=torch.float64))
    assert not state.joint_vel.any()


@pytest.mark.parametrize("function", ["success", "failure", "reward", "observe"])
def test_no_constant_stays_on_the_cpu(function, recorded):
    task = TASKS.get("humanoid/walk")()
    found = getattr(task, function)(recorded.to("meta", torch.float32))
    assert found.device.type == "meta"


def test_rewards_agree_in_single_and_double_precision(recorded):
    task = TASKS.get("humanoid/walk")()
    np.testing.assert_allclose(
        task.reward(recorded.to("cpu", torch.float32)), task.reward(recorded), atol=1e-4
    )
