"""An actuator that pulls a tendon over several joints, against numbers by hand."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, MissingExtraError, SimulatorError, UnknownNameError
from envs.mjcf.drives import DriveLengths, rest_targets
from envs.mjcf.robots import robot_spec
from envs.scenario import JointCfg, PhysicsCfg, RobotCfg, ScenarioCfg
from envs.simulators import HANDLERS
from envs.state import EntityState, State

FILE = """
<mujoco>
  <worldbody>
    <body name="base">
      <body name="one">
        <joint name="a" type="slide" axis="1 0 0"/><geom size="0.01" mass="1" contype="0" conaffinity="0"/>
      </body>
      <body name="two" pos="0 1 0">
        <joint name="b" type="slide" axis="0 0 1"/><geom size="0.01" mass="1" contype="0" conaffinity="0"/>
      </body>
      <body name="three" pos="0 2 0">
        <joint name="c" type="slide" axis="0 1 0"/><geom size="0.01" mass="1" contype="0" conaffinity="0"/>
      </body>
      <site name="hand"/>
    </body>
  </worldbody>
</mujoco>
"""
TIMESTEP_S = 0.002
PASSIVE = {"kp": 0.0, "kd": 0.0, "force_limit": 0.0, "range": (-9.0, 9.0), "driven": False}


def robot_of(folder, *, kd=0.0, force_limit=100.0, pulls=(("b", -3.0), ("c", 0.5))) -> RobotCfg:
    """Joint ``a`` and its tendon of length a - 3 b + c / 2, and three masses of 1 kg that slide."""
    file = folder / "slides.xml"
    file.write_text(FILE)
    a = JointCfg(
        name="a", kp=2.0, kd=kd, force_limit=force_limit, range=(-9.0, 9.0), default=0.2, pulls=pulls,
        target_range=(-8.0, 8.0),
    )  # fmt: skip
    passive = tuple(JointCfg(name=name, default=rest, **PASSIVE) for name, rest in (("b", 0.1), ("c", 0.4)))
    return RobotCfg(name="toy", mjcf=str(file), root="base", joints=(a, *passive), ee_site="hand")


def started(robot: RobotCfg, simulator: str):
    physics = PhysicsCfg(timestep_s=TIMESTEP_S, decimation=1)
    handler = HANDLERS.get(simulator)(ScenarioCfg(robots=(robot,), physics=physics), 1, num_threads=1)
    handler.launch()
    return handler


def state_of(target=None) -> State:
    robot = EntityState.at_rest(np.zeros(3), np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.3, 0.4, 0.2]]))
    robot.joint_vel = torch.tensor([[1.0, 2.0, -4.0]], dtype=torch.float64)
    robot.joint_target = None if target is None else torch.tensor([[target]], dtype=torch.float64)
    return State({"toy": robot}, {})


LENGTH = 0.3 - 3.0 * 0.4 + 0.5 * 0.2  # -0.8
SPEED = 1.0 - 3.0 * 2.0 + 0.5 * -4.0  # -7.0


@pytest.mark.parametrize(
    ("kd", "limit", "force"),
    [(0.0, 100.0, 2.0 * (0.5 - LENGTH)), (0.5, 100.0, 2.0 * (0.5 - LENGTH) - 0.5 * SPEED), (0.5, 4.0, 4.0)],
)
def test_each_joint_feels_its_coefficient_times_the_force(tmp_path, kd, limit, force):
    model = robot_spec(robot_of(tmp_path, kd=kd, force_limit=limit)).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.3, 0.4, 0.2), (1.0, 2.0, -4.0), 0.5
    mujoco.mj_forward(model, data)
    assert data.actuator_length[0] == pytest.approx(LENGTH)
    assert data.actuator_force[0] == pytest.approx(force)
    np.testing.assert_allclose(data.qfrc_actuator, np.array([1.0, -3.0, 0.5]) * force)


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["mujoco", "mujoco_warp"])
def test_a_step_accelerates_by_the_force_in_both_simulators(tmp_path, simulator):
    with started(robot_of(tmp_path), simulator) as handler:
        assert handler.get_joint_targets("toy").tolist()[0] == pytest.approx([0.2 - 0.3 + 0.2])
        handler.set_states(state_of().to(handler.device, handler.dtype))
        assert handler.get_joint_targets("toy").tolist()[0] == pytest.approx([LENGTH])  # what holds it there
        handler.set_states(state_of(0.5).to(handler.device, handler.dtype))
        handler.step(1)
        speeds = handler.get_states().robots["toy"].joint_vel[0].tolist()
    gained = TIMESTEP_S * 2.0 * (0.5 - LENGTH)
    assert speeds == pytest.approx([1.0 + gained, 2.0 - 3.0 * gained, -4.0 + 0.5 * gained], abs=1e-6)


def test_lengths_and_rests_are_sums_of_joints(tmp_path):
    robot = robot_of(tmp_path)
    joints = torch.tensor([[0.3, 0.4, 0.2], [1.0, 0.0, 2.0]])
    torch.testing.assert_close(DriveLengths(robot)(joints), torch.tensor([[LENGTH], [2.0]]))
    assert rest_targets(robot).tolist() == pytest.approx([0.1])
    single = replace(robot, joints=tuple(replace(j, driven=True, pulls=()) for j in robot.joints))
    assert DriveLengths(single)(joints) is joints


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["newton", "sapien", "pybullet", "genesis"])
def test_simulators_that_drive_single_joints_refuse(tmp_path, simulator):
    try:
        cls = HANDLERS.get(simulator)
    except MissingExtraError as error:
        pytest.skip(str(error))
    handler = cls(ScenarioCfg(robots=(robot_of(tmp_path),)), 1, num_threads=1)
    with pytest.raises(SimulatorError, match=r"'a' pulls a tendon over several.*simulator=mujoco_warp"):
        handler.launch()


def test_a_tendon_runs_over_joints_without_actuators(tmp_path):
    with pytest.raises(UnknownNameError, match="without an actuator that 'a' of 'toy' pulls 'd'"):
        robot_spec(robot_of(tmp_path, pulls=(("d", 1.0),)))
    with pytest.raises(UnknownNameError, match="without an actuator that 'a' of 'toy' pulls 'a'"):
        robot_spec(robot_of(tmp_path, pulls=(("a", 1.0),)))
    given = {**PASSIVE, "name": "a", "default": 0.0, "pulls": (("b", 1.0),)}
    for wrong in ({"driven": False, "target_range": (0.0, 1.0)}, {"driven": True}):
        with pytest.raises(ConfigError, match=r"'a' pulls a tendon over b too.*driven=True.*target_range"):
            JointCfg(**(given | wrong))
