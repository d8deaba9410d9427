"""Every task of HumanoidBench: the numbers that its classes, its robot and its scenes share."""

import mujoco
import numpy as np
import pytest

from envs.mjcf.model import build_model
from envs.robots.h1 import H1
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.tasks import TASKS
from tests.envs.tasks.humanoid.published import ASSETS, needs_assets

BARS = {
    "stand": 800,
    "walk": 700,
    "run": 700,
    "crawl": 700,
    "hurdle": 700,
    "stair": 700,
    "slide": 700,
    "pole": 700,
    "maze": 1200,
    "sit_simple": 750,
    "sit_hard": 750,
    "balance_simple": 800,
    "balance_hard": 800,
}
"""``success_bar`` of each class in HumanoidBench."""

FREE_THINGS = {"sit_hard": 1, "balance_simple": 1, "balance_hard": 2}
"""What moves beside the robot; each is 13 numbers more to observe."""


@pytest.fixture(params=sorted(BARS))
def task(request):
    return TASKS.get(f"humanoid/{request.param}")()


def test_none_is_missing():
    with_hands = {f"humanoid/h1hand_{name}" for name in ("stand", "walk", "run")}
    assert set(TASKS.names("humanoid")) == {f"humanoid/{name}" for name in BARS} | with_hands
    assert set(TASKS.names("hands")) == with_hands


def test_an_episode_is_a_thousand_steps_of_a_fiftieth_of_a_second(task):
    physics = task.scenario.physics
    assert task.max_episode_steps == 1000
    assert (physics.timestep_s, physics.decimation) == (0.002, 10)
    assert task.success_return == BARS[task.name.partition("/")[2]]
    assert not task.ends_on_success and not task.has_expert


def test_an_action_is_a_position_of_each_of_nineteen_joints(task):
    controller = task.rl_controller
    assert controller.names == H1.joint_names
    assert (controller.low == -1.0).all() and (controller.high == 1.0).all()
    assert len(controller.names) == 19


@pytest.mark.slow
def test_states_are_as_large_as_published(task):
    state = task.initial_state([np.random.default_rng(0)])
    free = FREE_THINGS.get(task.name.partition("/")[2], 0)
    assert sum(item.kind == "free" for item in task.objects) == free
    model = build_model(task.scenario)
    assert model.nq + model.nv == 51 + 13 * free
    assert model.nu == 19
    assert task.observe(state).shape == (1, 51 + 13 * free)


def test_noise_is_a_hundredth_and_on_every_number(task):
    first, second = (task.initial_state([np.random.default_rng(seed)]).robots["h1"] for seed in (0, 1))
    for one, other in ((first.joint_pos, second.joint_pos), (first.pos[:, 2:], second.pos[:, 2:])):
        assert 0.0 < (one - other).abs().max() <= 0.02
    assert not (first.joint_vel.any() or first.lin_vel.any() or first.ang_vel.any())


@pytest.mark.slow
def test_a_fall_fits_into_the_buffers_of_mujoco_warp(task):
    """A second of the largest random actions, until the robot has fallen, with room for half more."""
    scenario, rng = task.scenario, np.random.default_rng(0)
    model, given = build_model(scenario), WarpSettings.of(scenario)
    data, robot, contacts, rows = mujoco.MjData(model), task.robot, [], []
    data.qpos[:7] = [*robot.pos, *robot.rot]
    low, high = model.actuator_ctrlrange.T
    for _ in range(50):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data, scenario.physics.decimation)
        contacts.append(data.ncon)
        rows.append(data.nefc)
    assert data.qpos[2] < 0.8
    assert given.nconmax is not None and 4 <= max(contacts) <= given.nconmax / 1.5
    assert given.njmax is not None and max(rows) <= given.njmax / 1.5


def standing(robot, model, height_m):
    """The posture of the start with the pelvis at a height, in a compiled scene."""
    data = mujoco.MjData(model)
    data.qpos[:7] = [*robot.pos[:2], height_m, *robot.rot]
    for joint in robot.joints:
        data.qpos[model.joint(f"h1/{joint.name}").qposadr[0]] = joint.default
    mujoco.mj_forward(model, data)
    return data


@needs_assets
@pytest.mark.parametrize("height_m", [0.98, 0.9])
def test_the_package_and_the_folder_stand_and_touch_the_ground_alike(height_m):
    walk = TASKS.get("humanoid/walk")
    tasks = walk(), walk(model=str(ASSETS))
    models = [build_model(task.scenario) for task in tasks]
    ours, own = (standing(task.robot, model, height_m) for task, model in zip(tasks, models, strict=True))
    for index in range(1, models[1].nbody):
        name = models[1].body(index).name
        if not name.endswith("_hand"):  # places without mass, 1 cm apart
            np.testing.assert_allclose(ours.body(name).xpos, own.body(name).xpos, atol=1e-9, err_msg=name)

    def depths(model, data):
        touching = {}
        for contact in data.contact:
            bodies = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
            key = tuple(sorted(bodies))
            touching[key] = max(touching.get(key, 0.0), -contact.dist)
        return touching

    assert depths(models[0], ours).keys() == depths(models[1], own).keys()
    assert depths(models[0], ours) == pytest.approx(depths(models[1], own), abs=1.5e-3)
