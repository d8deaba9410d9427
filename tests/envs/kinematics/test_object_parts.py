"""Poses of parts and sites of articulated objects, against MuJoCo and by hand."""

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.kinematics.object_parts import parts_of
from envs.state import EntityState

DOOR = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="object" pos=".1 .2 .3">
  <geom type="box" size=".1 .1 .1"/>
  <body name="frame" pos="0 .1 0" quat=".8 0 .6 0">
    <body name="leaf" pos=".2 0 0" euler=".1 .2 .3">
      <joint name="hinge" axis="0 .6 .8" pos=".05 0 .02" range="-1 1"/>
      <geom type="capsule" size=".01 .05"/>
      <body name="bolt"><joint name="bolt" type="slide" axis="1 0 0" range="0 .1"/>
        <geom type="sphere" size=".02"/>
        <site name="tip" pos=".1 .2 .3" quat="0 1 0 0" size=".1 .2 .3" type="box"/>
      </body></body></body></body></worldbody></mujoco>"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "door.xml"
    file.write_text(DOOR)
    return file


def test_sites_are_where_mujoco_has_them(path):
    parts = parts_of(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    joints = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 2))
    entity = EntityState.at_rest(np.tile((0.1, 0.2, 0.3), (5, 1)), np.array((1.0, 0, 0, 0)), joints)
    pos, rot = parts.box_pose(entity, parts.site("tip"))
    for row, qpos in enumerate(joints):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(pos[row], data.site_xpos[0], atol=1e-12)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[0])
        assert abs(quat @ rot[row].numpy()) == pytest.approx(1.0)


def test_parts_joints_and_boxes_are_read(path):
    parts = parts_of(path)
    assert [part.name for part in parts.parts] == ["object", "frame", "leaf", "bolt"]
    assert [(joint.name, joint.kind, joint.column) for joint in parts.joints] == [
        ("hinge", "hinge", 0),
        ("bolt", "slide", 1),
    ]
    halves = [box.half for box in parts.boxes]
    np.testing.assert_allclose(halves, [(0.1,) * 3, (0.01, 0.01, 0.06), (0.02,) * 3])
    assert parts.joints[1].limits == (0.0, 0.1)


def test_it_works_in_another_precision(path):
    parts = parts_of(path)
    entity = EntityState.at_rest(np.zeros((2, 3)), np.array((1.0, 0, 0, 0)), np.zeros((2, 2)))
    single = EntityState(
        **{
            name: getattr(entity, name).float()
            for name in ("pos", "rot", "lin_vel", "ang_vel", "joint_pos", "joint_vel")
        }
    )
    assert parts.box_pose(single, parts.site("tip"))[0].dtype == torch.float32


def test_an_unknown_site_is_named_with_those_that_exist(path):
    with pytest.raises(UnknownNameError, match=r"Unknown site 'tap'.*tip"):
        parts_of(path).site("tap")


def test_a_part_with_two_joints_is_refused(tmp_path):
    file = tmp_path / "two.xml"
    file.write_text(
        '<mujoco><worldbody><body name="object"><geom size="1"/><body name="arm"><joint/>'
        '<joint axis="1 0 0"/><geom size="1"/></body></body></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match=r"'arm' of .* needs one hinge or one slide"):
        parts_of(file)
