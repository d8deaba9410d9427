"""Grippers keep the unit of their own file and what ties their joints."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.mjcf.robots import robot_spec
from envs.robots.franka import FRANKA
from envs.scenario import JointCfg

JAWS = """<mujoco>{compiler}
 <worldbody><body name="palm">
  <body name="left"><joint name="left" axis="0 1 0"/><geom size="0.01" mass="0.1"/></body>
  <body name="right" pos="0.05 0 0"><joint name="right" axis="0 1 0"/><geom size="0.01" mass="0.1"/>
   <site name="grip"/></body>
 </body></worldbody>
 <equality><joint joint1="left" joint2="right" polycoef="0 1 0 0 0"/></equality>
</mujoco>"""


def jaw(name, *, driven):
    gains = {"kp": 10.0, "kd": 0.5, "force_limit": 5.0, "armature": 0.01}
    return JointCfg(name=f"gripper/{name}", range=(0.0, 0.8), default=0.0, driven=driven, **gains)


@pytest.mark.parametrize("compiler", ["", '<compiler angle="radian"/>'])
def test_hinges_of_a_gripper_keep_their_range_and_their_ties(tmp_path, compiler):
    file = tmp_path / "jaws.xml"
    file.write_text(JAWS.format(compiler=compiler))
    robot = replace(
        FRANKA,
        gripper_mjcf=str(file),
        gripper_root="palm",
        ee_site="gripper/grip",
        joints=(*FRANKA.joints[:7], jaw("left", driven=True), jaw("right", driven=False)),
        gripper_joints=("gripper/left",),
    )
    model = robot_spec(robot).compile()
    for name in ("left", "right"):
        np.testing.assert_allclose(model.joint(f"franka/gripper/{name}").range, [0.0, 0.8])
    np.testing.assert_allclose(model.joint("franka/joint1").range, FRANKA.joints[0].range)
    assert model.neq == 1 and model.eq_type[0] == mujoco.mjtEq.mjEQ_JOINT
    data = mujoco.MjData(model)
    data.ctrl[model.actuator("franka/gripper/left").id] = 0.4
    mujoco.mj_step(model, data, 2000)
    for name in ("left", "right"):  # one is driven, the other follows
        assert data.joint(f"franka/gripper/{name}").qpos[0] == pytest.approx(0.4, abs=0.02)


def followed(tmp_path, leader, ratio=-0.5):
    file = tmp_path / "jaws.xml"
    file.write_text(re.sub(r"<equality>.*</equality>", "", JAWS.format(compiler="")))
    right = replace(jaw("right", driven=False), range=(-0.8, 0.8), follows=(leader, ratio))
    robot = replace(
        FRANKA,
        gripper_mjcf=str(file),
        gripper_root="palm",
        ee_site="gripper/grip",
        joints=(*FRANKA.joints[:7], jaw("left", driven=True), right),
        gripper_joints=("gripper/left",),
    )
    return robot_spec(robot).compile()


def test_a_joint_that_follows_is_tied_to_the_one_that_leads(tmp_path):
    model = followed(tmp_path, "gripper/left")
    data = mujoco.MjData(model)
    data.ctrl[model.actuator("franka/gripper/left").id] = 0.4
    mujoco.mj_step(model, data, 2000)
    assert data.joint("franka/gripper/left").qpos[0] == pytest.approx(0.4, abs=0.01)
    assert data.joint("franka/gripper/right").qpos[0] == pytest.approx(-0.2, abs=0.01)


def test_a_joint_follows_a_driven_one(tmp_path):
    with pytest.raises(
        UnknownNameError, match=r"driven joint that 'gripper/right' of 'franka' follows 'gripper/lef'"
    ):
        followed(tmp_path, "gripper/lef")
    with pytest.raises(ConfigError, match="'left' follows 'right', so it needs driven=False"):
        JointCfg(
            name="left",
            kp=1.0,
            kd=0.1,
            force_limit=1.0,
            range=(0.0, 1.0),
            default=0.0,
            follows=("right", 1.0),
        )


def test_a_gripper_without_ties_has_none():
    assert robot_spec(FRANKA).compile().neq == 0
