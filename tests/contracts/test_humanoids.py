"""A humanoid is the same robot, judged in the same way, in every simulator that takes it.

MuJoCo Warp, which has the same model, is compared step by step in ``test_two_simulators``.
"""

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError
from envs.simulators import HANDLERS
from envs.tasks import TASKS

NUM_ENVS = 2
TASK = TASKS.get("humanoid/walk")()
REST = np.array(TASK.robot.default_qpos)

OFF_RAD = {"newton": (0.004, 0.01), "sapien": (0.02, 0.02), "pybullet": (0.25, 0.25)}
"""How far joints are from where they are in MuJoCo: standing for 0.2 s, and driven for 0.1 s in the air with
actuators at their limits. PyBullet has no armature, and its drives take the base as held."""


def made(simulator):
    try:
        handler = HANDLERS.get(simulator)(TASK.scenario, NUM_ENVS, num_threads=1)
        handler.launch()
    except MissingExtraError as error:
        pytest.skip(str(error))
    return handler


@pytest.fixture(scope="module")
def mujoco():
    with made("mujoco") as handler:
        yield handler


@pytest.fixture(scope="module", params=OFF_RAD)
def other(request):
    with made(request.param) as handler:
        yield request.param, handler


def start(lift_m):
    states = TASK.initial_state([np.random.default_rng(i) for i in range(NUM_ENVS)])
    states.robots["h1"].pos[:, 2] += lift_m
    return states


def moved(handler, states, targets):
    """The states at the end, each of ``targets`` (T, N, J) held for a control step."""
    handler.set_states(states.to(handler.device, handler.dtype))
    for target in targets:
        handler.set_joint_targets({"h1": target})
        handler.step(TASK.scenario.physics.decimation)
    return handler.get_states().to("cpu", torch.float64)


def off(one, two):  # joints, rad, and base, m
    a, b = one.robots["h1"], two.robots["h1"]
    return tuple((getattr(a, key) - getattr(b, key)).abs().max().item() for key in ("joint_pos", "pos"))


@pytest.mark.slow
def test_observation_reward_and_failure_agree(mujoco, other):
    rng, states = np.random.default_rng(0), start(0.0)
    robot = states.robots["h1"]
    robot.pos[:, 2] = torch.tensor([0.15, 1.0])
    rot = robot.rot + torch.from_numpy(0.1 * rng.normal(size=robot.rot.shape))
    robot.rot = rot / torch.linalg.vector_norm(rot, dim=-1, keepdim=True)
    for key in ("lin_vel", "ang_vel", "joint_vel"):
        setattr(robot, key, torch.from_numpy(rng.normal(size=getattr(robot, key).shape)))
    robot.joint_target = robot.joint_pos + 0.1
    seen = [moved(handler, states, ()) for handler in (mujoco, other[1])]
    first, second = ((TASK.observe(s), TASK.reward(s)) for s in seen)
    for one, two in zip(first, second, strict=True):
        torch.testing.assert_close(two, one, atol=1e-6, rtol=0.0)
    assert first[1].min() < 0.1 < first[1].max()
    assert [TASK.failure(s).tolist() for s in seen] == [[True, False]] * 2


@pytest.mark.slow
def test_standing_agrees(mujoco, other):
    """Feet come down from 2 cm, for a foot in the ground is put out of it in one way or another."""
    targets = np.tile(REST, (10, NUM_ENVS, 1))
    joints, base = off(*(moved(handler, start(0.02), targets) for handler in (mujoco, other[1])))
    assert joints < OFF_RAD[other[0]][0]
    assert base < 0.02


@pytest.mark.slow
def test_actuators_at_their_limits_push_alike(mujoco, other):
    """Shoulders and elbows saturate, and their damping adds to the saturated force."""
    low, high = np.array([joint.range for joint in TASK.robot.joints]).T
    aim = REST + 0.3 * (low + (high - low) * np.random.default_rng(0).uniform(size=(NUM_ENVS, 19)) - REST)
    targets = np.tile(aim, (5, 1, 1))
    ends = [moved(handler, start(1.0), targets) for handler in (mujoco, other[1])]
    joints, base = off(*ends)
    assert joints < OFF_RAD[other[0]][1]
    assert base < 0.01
