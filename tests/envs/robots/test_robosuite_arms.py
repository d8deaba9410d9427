"""Arms that hold still at their targets, and that inverse kinematics can follow."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from envs.core.errors import UnknownNameError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.robots import ROBOTS
from envs.scenario import ScenarioCfg
from envs.tasks.tabletop import CONTROL_20_HZ
from tests.robot_files import needs_files_of
from tests.sweeps import sweep

ARMS = ("iiwa", "ur5e", "sawyer_panda", "kinova3", "xarm7", "jaco")
LIGHT = tuple(f"{arm}_2f85" for arm in ("franka", "iiwa", "ur5e", "sawyer", "kinova3", "xarm7", "jaco"))
"""A gripper without the inertia of robosuite's Franka hand."""
OWN = ("sawyer_rethink", "xarm7_xarm_gripper", "jaco_three_finger")
"""With the gripper of the arm's maker."""


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep([*ARMS, *LIGHT, *OWN], [*ARMS, "iiwa_2f85", "jaco_three_finger"]))
def test_an_arm_comes_to_rest_after_a_jump_of_its_targets(name):
    """A wrist whose motors turn their whole force round in every step would chatter for ever."""
    needs_files_of(name)
    robot = replace(ROBOTS.get(name), pos=(0.0, 0.0, 0.2))  # a long gripper would touch the floor
    scenario = ScenarioCfg(robots=(robot,), table=None, room=None, physics=CONTROL_20_HZ)
    model = build_model(scenario)
    qpos = layout_of(model, scenario).robots[0].qpos
    for turned in (-0.2, 0.0):
        data = mujoco.MjData(model)
        start = np.array(robot.default_qpos)
        start[robot.arm[-3]] += turned
        data.qpos[qpos] = start
        target = start.copy()
        target[list(robot.arm)] += 0.1
        data.ctrl[:] = target[list(robot.driven)]
        for _ in range(600):
            mujoco.mj_step(model, data)
        error = np.abs(data.qpos[qpos] - target)[list(robot.arm)].max()
        assert error < 0.003, f"{name}, wrist turned by {turned}: {error:.3f} rad off after 1.2 s"


@pytest.mark.parametrize("name", ["kinova3", "jaco"])
def test_rotor_inertia_of_kinovas_arms_keeps_a_saturated_damper_stable(name):
    for joint in (ROBOTS.get(name).joints[index] for index in ROBOTS.get(name).arm):
        assert joint.armature is not None
        assert joint.armature >= 0.5 * joint.kd * CONTROL_20_HZ.timestep_s


def test_kinovas_elbow_stays_on_one_side():
    low, high = ROBOTS.get("kinova3").joints[3].range
    assert 0.0 < low < high


@pytest.mark.slow
@pytest.mark.parametrize("height_m", [0.0, 0.2, 0.5])
def test_sawyers_first_link_does_not_rub_on_its_base(height_m):
    """Their shapes touch in a point, or miss each other by a rounding error, wherever the base is."""
    robot = replace(ROBOTS.get("sawyer_panda"), pos=(0.0, 0.0, height_m))
    scenario = ScenarioCfg(robots=(robot,), table=None, room=None, physics=CONTROL_20_HZ)
    model = build_model(scenario)
    data, qpos = mujoco.MjData(model), layout_of(model, scenario).robots[0].qpos
    data.qpos[qpos] = robot.default_qpos
    data.ctrl[:] = np.array(robot.default_qpos)[list(robot.driven)]
    data.ctrl[0] += 0.1
    for _ in range(600):
        mujoco.mj_step(model, data)
        assert "sawyer_panda/right_l0" not in touched(model, data)
    assert data.qpos[qpos[0]] == pytest.approx(robot.default_qpos[0] + 0.1, abs=1e-5)


def touched(model, data):
    geoms = data.contact.geom[: data.ncon].ravel()
    return {model.body(model.geom_bodyid[geom]).name for geom in geoms}


def test_bodies_that_are_apart_are_of_the_robots_file():
    robot = replace(ROBOTS.get("sawyer_panda"), apart=(("right_arm_base_link", "right_l9"),))
    with pytest.raises(
        UnknownNameError, match=r"body of robot 'sawyer_panda' 'right_l9'.*Did you mean 'right_l"
    ):
        build_model(ScenarioCfg(robots=(robot,), table=None, room=None))
