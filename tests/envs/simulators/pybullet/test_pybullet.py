"""Bullet's own parts: its drives, its form of MuJoCo's joints, its one light."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

pytest.importorskip("pybullet")

from envs.core.errors import ConfigError, SimulatorError, UnknownNameError
from envs.scenario import GeomCfg, LightCfg, LinkCfg, ObjectCfg, ObjectJointCfg, PhysicsCfg, ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.simulators.pybullet.handler import PybulletHandler
from envs.simulators.pybullet.meshes import triangles_of
from envs.simulators.pybullet.render import _one_light
from envs.simulators.pybullet.settings import PybulletSettings
from envs.simulators.pybullet.trees import trees_of
from envs.simulators.pybullet.world import PybulletWorld
from envs.tasks.pick_cube import PickCube


def launched(kind, scenario, num_envs=1):
    handler = kind(scenario, num_envs, renderer="warp")
    handler.launch()
    return handler


FAR = np.array([0.2, -0.1, 0.2, 0.1, -0.2, 0.1, 0.3, -0.02, -0.02])


@pytest.mark.parametrize(("share", "tolerance"), [(0.05, 2e-3), (1.0, 0.03)])
def test_the_arm_moves_as_in_mujoco(share, tolerance):
    """Within what its motors can give, and where they give all they have."""
    task = PickCube()
    states = task.initial_state([np.random.default_rng(0)])
    target = states.robots["franka"].joint_pos + share * torch.from_numpy(FAR)
    paths = []
    for kind in (MujocoHandler, PybulletHandler):
        with launched(kind, task.scenario) as handler:
            handler.set_states(states)
            handler.set_joint_targets({"franka": target})
            path = []
            for _ in range(20):
                handler.step(5)
                path.append(handler.get_states().robots["franka"].joint_pos[0].double().numpy())
            paths.append(np.array(path))
    assert np.abs(paths[0] - paths[1]).max() < tolerance


def box_on_a_hinge(**joint):
    link = LinkCfg(
        name="lid",
        geoms=(GeomCfg(shape="box", size=(0.1, 0.1, 0.01), pos=(0.1, 0.0, 0.0), mass_kg=0.5),),
        joint=ObjectJointCfg(kind="hinge", axis=(0.0, 1.0, 0.0), range=(-1.5, 1.5), **joint),
    )
    base = GeomCfg(shape="box", size=(0.02, 0.02, 0.02), mass_kg=1.0)
    thing = ObjectCfg(name="box", kind="fixed", geoms=(base,), links=(link,), pos=(0.0, 0.0, 1.0))
    return ScenarioCfg(objects=(thing,), physics=PhysicsCfg(timestep_s=0.005))


@pytest.mark.parametrize(
    ("joint", "least", "most"),
    [
        ({"frictionloss": 1.0}, 0.0, 0.01),  # 0.49 N·m of weight are too little to move it
        ({"frictionloss": 0.05}, 1.3, 1.6),
        ({"damping": 0.5}, 0.44, 0.48),  # as in MuJoCo
        ({"damping": 50.0}, 0.0, 0.1),  # far beyond what an explicit integration would bear
        ({"stiffness": 10.0}, 0.0, 0.1),
    ],
)
def test_a_passive_joint_obeys_its_friction_damping_and_spring(joint, least, most):
    with launched(PybulletHandler, box_on_a_hinge(**joint)) as handler:
        handler.step(100)
        turned = float(handler.get_states().objects["box"].joint_pos[0, 0])
    assert least <= turned <= most


def test_a_grip_holds_with_the_force_of_its_gain():
    """The fingers press on a cube that is 3 cm wide with kp times what keeps them from their target."""
    task = PickCube()
    with launched(PybulletHandler, task.scenario) as handler:
        states = task.initial_state([np.random.default_rng(0)])
        handler.set_states(states)
        ee = handler.get_states().robots["franka"].ee_pos
        states.objects["cube"].pos = ee.double()
        states.objects["cube"].rot = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
        robot = states.robots["franka"]
        robot.joint_target = robot.joint_pos.clone()
        robot.joint_target[:, 7:] = 0.0
        handler.set_states(states)
        handler.step(200)
        after = handler.get_states()
        assert float((after.objects["cube"].pos - ee).abs().max()) < 0.015  # it is held in the air
        assert (after.robots["franka"].joint_pos[0, 7:] > 0.015).all()


def test_settings_are_checked():
    with pytest.raises(
        UnknownNameError,
        match=r"setting of simulator=pybullet 'iteratons'.*Did you mean 'iterations'",
    ):
        PybulletSettings.of(ScenarioCfg(simulators={"pybullet": {"iteratons": 3}}))
    with pytest.raises(ConfigError, match="iterations ≥ 1"):
        PybulletSettings(iterations=0)


def test_after_close_nothing_runs():
    handler = launched(PybulletHandler, PickCube().scenario)
    handler.close()
    with pytest.raises(SimulatorError, match=r"call launch\(\) first"):
        handler.step(1)


HINGE = "<joint name='{}' axis='0 1 0'/><geom size='.1'/>"
TWO = (
    "<mujoco><worldbody><body name='arm'>" + HINGE.format("shoulder") + "<body name='hand' pos='1 0 0'>"
    + HINGE.format("wrist") + "</body></body></worldbody>{}</mujoco>"
)  # fmt: skip


@pytest.mark.parametrize(
    ("mjcf", "said"),
    [
        (
            "<mujoco><worldbody><body name='arm'><joint name='shoulder' type='ball'/><geom size='.1'/></body>"
            "</worldbody></mujoco>",
            r"no ball joint such as 'shoulder'.*simulator=mujoco",
        ),
        (
            TWO.format("<equality><joint joint1='shoulder' joint2='wrist'/></equality>"),
            r"no equality constraint such as that of 'shoulder' and 'wrist'.*simulator=mujoco",
        ),
        (
            TWO.format("<tendon><fixed name='cord'><joint joint='shoulder' coef='1'/></fixed></tendon>"),
            r"no tendon such as 'cord'.*simulator=mujoco",
        ),
    ],
)
def test_what_bullet_has_not_is_refused_by_name(mjcf, said):
    with pytest.raises(SimulatorError, match=said):
        trees_of(mujoco.MjModel.from_xml_string(mjcf))


def test_many_launches_leave_no_client_behind():
    import pybullet

    scenario = box_on_a_hinge()
    for _ in range(30):
        launched(PybulletHandler, scenario, 2).close()
    client = pybullet.connect(pybullet.DIRECT)
    assert client < 5
    pybullet.disconnect(client)


def test_lights_become_one_and_keep_their_sum():
    sun = LightCfg(direction=(0.0, 0.0, -2.0), intensity=0.5, cast_shadow=True)
    lamp = LightCfg(kind="area", color=(1.0, 0.5, 0.5), intensity=0.4)
    alone, both = _one_light([sun]), _one_light([lamp, sun])
    assert alone["lightDirection"] == [0.0, 0.0, 1.0] and alone["shadow"] == 1
    np.testing.assert_allclose(alone["lightColor"], 3 * [0.65])
    assert alone["lightAmbientCoeff"] + alone["lightDiffuseCoeff"] == pytest.approx(1.0)
    assert both["lightDirection"] == [0.0, 0.0, 1.0]
    assert both["lightColor"][0] > alone["lightColor"][0]
    assert both["lightColor"][0] > both["lightColor"][1]
    assert both["lightAmbientCoeff"] > alone["lightAmbientCoeff"]


SHAPES = {
    "sphere": (".1", 4 / 3 * np.pi * 0.001),
    "capsule": (".1 .2", np.pi * 0.01 * 0.4 + 4 / 3 * np.pi * 0.001),
    "cylinder": (".1 .2", np.pi * 0.01 * 0.4),
    "ellipsoid": (".1 .2 .3", 4 / 3 * np.pi * 0.006),
    "box": (".1 .2 .3", 0.048),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_are_closed_face_outwards_and_have_their_volume(shape):
    import trimesh

    size, volume = SHAPES[shape]
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><geom type='{shape}' size='{size}'/></worldbody></mujoco>"
    )
    drawn = triangles_of(model, 0)
    solid = trimesh.Trimesh(drawn.vertices, drawn.faces, process=False)
    assert solid.volume == pytest.approx(volume, rel=0.04)
    corners = drawn.vertices[drawn.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    large = np.linalg.norm(across, axis=1) > 1e-9
    assert ((across * drawn.normals[drawn.faces[:, 1]]).sum(1)[large] > 0).all()


def test_images_of_two_looks_differ_and_furniture_is_seen():
    task = PickCube()
    cameras = tuple(dataclasses.replace(camera, width=32, height=32) for camera in task.scenario.cameras)
    scenario = dataclasses.replace(task.scenario, cameras=cameras)
    with PybulletHandler(scenario, 2) as handler:
        handler.launch()
        handler.set_states(task.initial_state([np.random.default_rng(0)] * 2))
        look = dataclasses.replace(
            scenario.appearance, lights=(LightCfg(intensity=0.3, direction=(1.0, 0.0, -1.0)),)
        )
        handler.set_appearance(look, 1)
        first, second = handler.render(["front"])["front"]["rgb"]
        assert first.mean() > second.mean() + 10
        assert "roughness" in handler.not_shown


def two_boxes(**second):
    """A free box above a fixed one."""
    low = ObjectCfg(
        name="low", kind="fixed", geoms=(GeomCfg(shape="box", size=(0.2, 0.2, 0.1)),), pos=(0.0, 0.0, 1.0)
    )
    geom = GeomCfg(**{"shape": "box", "size": (0.05, 0.05, 0.05), "mass_kg": 1.0, **second})
    high = ObjectCfg(name="high", geoms=(geom,), pos=(0.0, 0.0, 1.2))
    return ScenarioCfg(objects=(low, high), table=None, physics=PhysicsCfg(timestep_s=0.005))


def test_what_does_not_collide_in_mujoco_falls_through_in_bullet():
    heights = {}
    for collides in (True, False):
        with launched(PybulletHandler, two_boxes(collides=collides)) as handler:
            handler.step(100)
            heights[collides] = float(handler.get_states().objects["high"].pos[0, 2])
    assert heights[True] == pytest.approx(1.15, abs=2e-3)
    assert heights[False] < 0.5


@pytest.mark.parametrize("friction", [0.1, 1.0])
def test_friction_decides_how_far_a_box_slides(friction):
    scenario = two_boxes(friction=(friction, 0.005, 0.0001))
    with launched(PybulletHandler, scenario) as handler:
        states = handler.get_states()
        states.objects["high"].pos[:] = torch.tensor([-0.1, 0.0, 1.15])
        states.objects["high"].lin_vel[:] = torch.tensor([0.5, 0.0, 0.0])
        handler.set_states(states)
        handler.step(200)
        slid = float(handler.get_states().objects["high"].pos[0, 0]) + 0.1
    assert slid == pytest.approx(0.5**2 / (2 * friction * 9.81), rel=0.25, abs=4e-3)


def test_a_box_off_its_centre_of_mass_keeps_its_pose_and_turns_about_the_centre():
    scenario = two_boxes(pos=(0.1, 0.0, 0.0))
    scenario = dataclasses.replace(
        scenario, physics=dataclasses.replace(scenario.physics, gravity=(0.0,) * 3)
    )
    with launched(PybulletHandler, scenario) as handler:
        states = handler.get_states()
        states.objects["high"].pos[:] = torch.tensor([2.0, 0.0, 3.0])
        states.objects["high"].ang_vel[:] = torch.tensor([0.0, 0.0, np.pi])
        states.objects["high"].lin_vel[:] = torch.tensor([0.0, -0.1 * np.pi, 0.0])
        handler.set_states(states)
        handler.step(200)  # half a turn about the centre of mass, which stays at rest
        after = handler.get_states().objects["high"]
    np.testing.assert_allclose(after.pos[0], [2.2, 0.0, 3.0], atol=2e-3)
    np.testing.assert_allclose(after.rot[0].abs(), [0.0, 0.0, 0.0, 1.0], atol=5e-3)
    np.testing.assert_allclose(after.ang_vel[0], [0.0, 0.0, np.pi], atol=1e-3)


TOWER = """
<mujoco><option timestep=".002"/><worldbody>
  <body name="base" pos="0 0 1"><geom name="floor" type="box" size=".2 .2 .05"/>
    <body name="lift" pos="0 0 .3"><joint name="up" type="slide" axis="0 0 1"/>
      <geom type="box" size=".1 .1 .1"/>
      <body name="tip" pos="0 0 .3"><joint name="out" type="slide" axis="0 0 1" range="-.1 .1"/>
        <geom name="ball" size=".02"/></body>
    </body>
  </body>
</worldbody><contact><pair geom1="ball" geom2="floor"/></contact></mujoco>
"""


def test_a_link_rests_on_its_fixed_root_as_in_mujoco():
    model = mujoco.MjModel.from_xml_string(TOWER)
    data = mujoco.MjData(model)
    world = PybulletWorld(model, trees_of(model), PybulletSettings())
    qpos, qvel = data.qpos.copy(), data.qvel.copy()
    world.put(qpos, qvel, np.zeros(0))
    world.step(500)
    world.read(qpos, qvel)
    world.close()
    mujoco.mj_step(model, data, 500)
    assert qpos[0] == pytest.approx(data.qpos[0], abs=5e-3) == pytest.approx(-0.15, abs=5e-3)
