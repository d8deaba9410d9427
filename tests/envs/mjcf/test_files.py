"""What a scene takes from MJCF files, and what it changes about it."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.mjcf.files import read
from envs.mjcf.model import build_model
from envs.mjcf.objects import HIDDEN_GROUP, SCENE_GROUP
from envs.robots.franka import FRANKA
from envs.scenario import GeomCfg, JointCfg, ObjectCfg, PhysicsCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.simulators.mujoco.handler import MujocoHandler

SCENE = """
<mujoco>
  <compiler angle="radian" inertiagrouprange="4 5"/>
  <asset>
    <mesh name="used" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
    <mesh name="unused" vertex="0 0 0  2 0 0  0 2 0  0 0 2"/>
  </asset>
  <worldbody>
    <light/>
    <body name="cabinet" pos="5 5 5" euler="1.57 0 0">
      <geom type="box" size=".1 .1 .1" group="4" friction="2 .1 .01" solref=".01 1" solimp=".8 .9 .01"/>
      <geom type="mesh" mesh="used" group="1" contype="0" conaffinity="0"/>
      <geom type="sphere" size=".3" group="1" contype="0" conaffinity="0" rgba="1 1 1 0"/>
      <body pos="0 0 .15">
        <joint type="slide" axis="0 0 1" range="-.1 .1" limited="true"/>
        <geom type="box" size=".1 .1 .1" group="4" mass="1" friction=".5 .2 .02" solref=".03 1"/>
      </body>
    </body>
    <body name="puck" pos="1 2 3">
      <joint type="free" damping=".5"/>
      <inertial mass="2" pos="0 0 0" diaginertia=".1 .1 .1"/>
      <geom type="sphere" size=".05" group="0"/>
    </body>
  </worldbody>
</mujoco>
"""

ARM = """
<mujoco>
  <worldbody>
    <body name="base">
      <geom type="sphere" size=".02" mass="1"/>
      <body name="upper">
        <joint name="loose" type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
        <body name="tip" pos=".3 0 0">
          <joint name="finger" type="slide" axis="0 1 0"/>
          <geom type="sphere" size=".02" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    passive = JointCfg(
        name="loose", kp=0.0, kd=0.0, force_limit=0.0, range=(-2.0, 2.0), default=0.3, driven=False
    )
    finger = JointCfg(
        name="finger",
        kp=10.0,
        kd=1.0,
        force_limit=5.0,
        range=(0.0, 0.1),
        default=0.02,
        target_range=(-1.0, 1.0),
    )
    return RobotCfg(
        name="arm",
        mjcf=str(path),
        root="base",
        joints=(passive, finger),
        ee_site="tip",
        gravity_compensated=False,
    )


def cabinet(scene, **changes):
    options = {"mjcf_root": "cabinet", "mjcf_joints": ("body2",), "pos": (0.0, 0.0, 1.0), "kind": "fixed"}
    return ObjectCfg(name="cabinet", mjcf=scene, **{**options, **changes})


def model_of(*objects, robots=()):
    return build_model(ScenarioCfg(robots=robots, objects=objects, table=None, room=None))


def test_an_objects_place_is_the_scenarios_and_not_the_files(scene):
    model = model_of(cabinet(scene))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("cabinet/cabinet").xpos, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(data.body("cabinet/cabinet").xquat, (1.0, 0.0, 0.0, 0.0))
    # A body and a joint without names are called after their place and their body.
    np.testing.assert_allclose(data.body("cabinet/body2").xpos, (0.0, 0.0, 1.15))
    assert model.joint("cabinet/body2").type == mujoco.mjtJoint.mjJNT_SLIDE


def test_a_link_touches_what_it_is_jointed_to_as_in_its_file(scene):
    def contact(model, height):
        data = mujoco.MjData(model)
        data.qpos[0] = height
        mujoco.mj_forward(model, data)
        first = data.contact[0]
        return len(data.contact), first.dist, *first.friction, *first.solref, *first.solimp, first.dim

    spec = mujoco.MjSpec.from_file(scene)
    spec.delete(spec.body("puck"))
    np.testing.assert_allclose(contact(model_of(cabinet(scene)), 0.0), contact(spec.compile(), 0.0))


def test_only_visible_opaque_groups_are_rendered(scene):
    model = model_of(cabinet(scene, mjcf_shown=(1,)))
    groups = model.geom_group[
        [g for g in range(model.ngeom) if "cabinet" in model.body(model.geom_bodyid[g]).name]
    ]
    assert sorted(groups.tolist()) == sorted([4, SCENE_GROUP, HIDDEN_GROUP, 4])
    assert SCENE_GROUP not in model_of(cabinet(scene, mjcf_shown=())).geom_group[1:]


def test_unused_assets_are_not_imported(scene):
    assert model_of(cabinet(scene)).nmesh == 1
    assert model_of(ObjectCfg(name="puck", mjcf=scene, mjcf_root="puck")).nmesh == 0


def test_the_files_rules_for_masses_are_kept(scene):
    model = model_of(cabinet(scene))
    assert model.body("cabinet/body2").mass == 1.0
    puck = model_of(ObjectCfg(name="puck", mjcf=scene, mjcf_root="puck"))
    assert puck.body("puck").mass == 2.0


def test_a_free_object_keeps_the_damping_of_its_files_joint(scene):
    puck = ObjectCfg(name="puck", mjcf=scene, mjcf_root="puck", pos=(0.1, 0.2, 0.3))
    model = model_of(puck)
    np.testing.assert_allclose(model.dof_damping[:6], 0.5)
    with MujocoHandler(ScenarioCfg(objects=(puck,), table=None), 2, num_threads=1) as handler:
        handler.launch()
        np.testing.assert_allclose(handler.get_states().objects["puck"].pos, [[0.1, 0.2, 0.3]] * 2)


def test_a_marker_pulls_a_body_to_its_place(arm):
    ball = (GeomCfg(shape="sphere", size=(0.01,), visible=False),)
    puller = ObjectCfg(name="puller", geoms=ball, kind="marker", pulls="arm/tip", pos=(0.2, 0.0, -0.2))
    scenario = ScenarioCfg(robots=(arm,), objects=(puller,), table=None, room=None)
    with MujocoHandler(scenario, 2, num_threads=1) as handler:
        handler.launch()
        reached = []
        for aside in (0.01, 0.09):
            pos = torch.tensor([[0.3, aside, 0.0]] * 2, dtype=torch.float64)
            handler.set_poses({"puller": (pos, torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 2))})
            handler.step(400)
            reached.append(handler.get_states().robots["arm"].ee_pos[:, 1])
    assert (reached[0] < 0.03).all()
    assert (reached[1] > 0.07).all()


def test_who_may_pull_what(arm):
    ball = (GeomCfg(shape="sphere", size=(0.01,), mass_kg=0.1),)
    with pytest.raises(ConfigError, match=r"Object 'puller' is free, so it cannot pull 'arm/tip'"):
        ObjectCfg(name="puller", geoms=ball, pulls="arm/tip")
    puller = ObjectCfg(name="puller", geoms=ball, kind="marker", pulls="arm/tipp")
    with pytest.raises(UnknownNameError, match=r"that the object 'puller' pulls 'arm/tipp'.*mean 'arm/tip'"):
        model_of(puller, robots=(arm,))


def test_a_joint_without_an_actuator_is_part_of_the_state_alone(arm):
    with MujocoHandler(ScenarioCfg(robots=(arm,), table=None, room=None), 2, num_threads=1) as handler:
        handler.launch()
        assert handler.model.nu == 1
        state = handler.get_states().robots["arm"]
        np.testing.assert_allclose(state.joint_pos, [[0.3, 0.02]] * 2)
        np.testing.assert_allclose(state.joint_target, [[0.02]] * 2)
        handler.set_joint_targets({"arm": np.array([[-3.0], [0.5]])})
        np.testing.assert_allclose(handler.get_states().robots["arm"].joint_target, [[-1.0], [0.5]])
        states = handler.get_states()
        states.robots["arm"].joint_target = None
        handler.set_states(states)
        np.testing.assert_allclose(handler.get_states().robots["arm"].joint_target, [[0.02]] * 2)


def test_the_end_effector_may_be_a_body(arm):
    model = model_of(robots=(arm,))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.site("arm/tip").xpos, data.body("arm/tip").xpos)
    with pytest.raises(UnknownNameError, match=r"end effector \(ee_site\) of robot 'arm' 'tpi'.*mean 'tip'"):
        model_of(robots=(dataclasses.replace(arm, ee_site="tpi"),))


def test_an_unknown_root_is_refused(arm):
    with pytest.raises(UnknownNameError, match=r"Unknown root of '.*arm.xml' 'bse'.*Did you mean 'base'"):
        model_of(robots=(dataclasses.replace(arm, root="bse"),))


def test_the_solvers_settings_are_the_scenarios():
    block = {
        "integrator": "euler",
        "cone": "pyramidal",
        "jacobian": "dense",
        "impratio": 2.0,
        "iterations": 7,
    }
    option = build_model(ScenarioCfg(simulators={"mujoco": block})).opt
    assert option.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert option.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
    assert (option.impratio, option.iterations, option.tolerance) == (2.0, 7, 1e-8)
    with pytest.raises(
        UnknownNameError, match=r"setting of simulator=mujoco 'iteration'.*Did you mean 'iterations'"
    ):
        build_model(ScenarioCfg(simulators={"mujoco": {"iteration": 7}}))
    with pytest.raises(UnknownNameError, match=r"cone of mujoco 'conic'.*Valid: elliptic, pyramidal"):
        build_model(ScenarioCfg(simulators={"mujoco": {"cone": "conic"}}))


def test_a_table_may_be_seen_or_touched_alone():
    untouched = build_model(ScenarioCfg(table=TableCfg(collides=False)))
    assert "table_collision" not in [untouched.geom(i).name for i in range(untouched.ngeom)]
    unseen = build_model(ScenarioCfg(table=TableCfg(visible=False)))
    assert unseen.geom("table").group == HIDDEN_GROUP
    assert unseen.geom("table_collision").contype == 1


GATE = """
<mujoco>
  <worldbody>
    <body name="gate">
      <geom type="box" size=".1 .1 .1" mass="1"/>
      <site name="hook" pos="0 0 .2"/>
      <body name="left" pos="0 .2 0">
        <joint name="left" type="slide" axis="0 1 0"/>
        <geom type="sphere" size=".02" mass="1" contype="0" conaffinity="0"/>
      </body>
      <body name="right" pos="0 -.2 0">
        <joint name="right" type="slide" axis="0 1 0"/>
        <geom type="sphere" size=".02" mass="1" contype="0" conaffinity="0"/>
        <site name="eye"/>
      </body>
      <site name="unused"/>
    </body>
    <body name="other"><joint name="other"/><geom size=".01"/></body>
  </worldbody>
  <equality>
    <joint joint1="left" joint2="right" polycoef="0 -1 0 0 0"/>
    <joint joint1="left" joint2="other"/>
    <weld body1="right" body2="other"/>
    {}
  </equality>
</mujoco>
"""


def gate(tmp_path, more=""):
    path = tmp_path / "gate.xml"
    path.write_text(GATE.format(more))
    joints = ("left", "right")
    return ObjectCfg(name="gate", mjcf=str(path), mjcf_root="gate", mjcf_joints=joints, kind="fixed")


def test_an_object_keeps_the_equality_constraints_of_its_own_parts(tmp_path):
    model = model_of(gate(tmp_path))
    assert model.neq == 1  # what its file ties to other bodies is not there
    assert [model.joint(int(ids[0])).name for ids in (model.eq_obj1id, model.eq_obj2id)] == [
        "gate/left",
        "gate/right",
    ]
    data = mujoco.MjData(model)
    data.joint("gate/right").qvel[0] = 0.5
    mujoco.mj_step(model, data, 200)
    assert abs(data.joint("gate/right").qpos[0]) > 0.05
    np.testing.assert_allclose(data.joint("gate/left").qpos, -data.joint("gate/right").qpos, atol=2e-3)


def test_the_sites_that_an_object_is_tied_at_come_along_and_no_others(tmp_path):
    model = model_of(gate(tmp_path, '<connect site1="hook" site2="eye"/>'))
    assert model.neq == 2
    assert {model.site(i).name for i in range(model.nsite)} == {"gate/hook", "gate/eye"}


def test_an_object_that_its_file_ties_to_the_world_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"ties 'left' to the world; .*Tie it to the object's root, 'gate'"):
        model_of(gate(tmp_path, '<connect body1="left" anchor="0 0 0"/>'))


def test_a_simulator_without_equality_constraints_names_the_joints_that_one_ties(tmp_path):
    from envs.core.errors import SimulatorError
    from envs.mjcf.link_tree import describe

    with pytest.raises(SimulatorError, match=r"equality constraint .* 'gate/left' and 'gate/right'"):
        describe(model_of(gate(tmp_path)), "newton")


def test_a_file_that_mujoco_cannot_read_is_named_with_the_reason(tmp_path):
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco>\n<worldbody></mujoco>")
    with pytest.raises(
        ConfigError, match=r"^'.*broken.xml' is no MJCF file: XML parse error .* Line number=2"
    ):
        read(mujoco.MjSpec(), str(path))


def test_a_robot_file_of_the_users_is_read_again(arm):
    file, masses = Path(arm.mjcf), []
    for mass in ("1", "3"):
        file.write_text(ARM.replace('size=".02" mass="1"', f'size=".02" mass="{mass}"'))
        masses.append(float(model_of(robots=(arm,)).body("arm/base").mass[0]))
    assert masses == [1.0, 3.0]


def test_what_a_scene_changes_of_a_robot_is_not_in_the_next_scene():
    def saved(*, timestep_s=0.005, **changes):
        physics = PhysicsCfg(timestep_s=timestep_s)
        robots = (dataclasses.replace(FRANKA, **changes),)
        model = build_model(ScenarioCfg(robots=robots, physics=physics))
        content = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, content)
        return content.tobytes()

    before = saved()
    stick = (GeomCfg(shape="box", size=(0.01, 0.01, 0.1)),)
    assert before not in (saved(timestep_s=0.002), saved(tool=stick), saved(gravity_compensated=False))
    assert saved() == before
