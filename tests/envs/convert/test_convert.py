"""Conversion of robots: what is written, what is read back, what is refused."""

import json
import logging
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from docs.generate.conversion.check import check, compare
from docs.generate.conversion.readers import MujocoReader
from envs.convert import convert
from envs.convert.conversion import describe, describe_loaded
from envs.convert.obj import mesh_files
from envs.convert.shapes import convex_hull
from envs.convert.source import load
from envs.convert.urdf import roll_pitch_yaw
from envs.core.errors import ConfigError, UnknownNameError
from envs.robots.franka import FRANKA
from envs.rotations import from_euler, to_matrix


def joint_of(path, name):
    return next(joint for joint in ET.parse(path).getroot().findall("joint") if joint.get("name") == name)


def number(element, child, key):
    found = element.find(child)
    assert found is not None, (element.get("name"), child)
    return float(found.get(key))


@pytest.mark.slow
@pytest.mark.parametrize("program", ["MuJoCo", "PyBullet", "UsdPhysics"])
def test_links_are_where_they_were_and_weigh_what_they_weighed(hard_robot, program):
    if program == "PyBullet":
        pytest.importorskip("pybullet")
    if program == "UsdPhysics":
        pytest.importorskip("pxr")
    (row,) = check(hard_robot, programs=[program], postures=100)
    assert row.verdict == "pass", row
    assert (row.links, row.joints) == (6, 6)
    assert row.errors.rotation_rad < 2e-6


@pytest.mark.slow
def test_the_franka_passes_and_has_its_drives(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path))
    (row,) = check("franka", programs=["MuJoCo"], postures=20)
    assert row.verdict == "pass", row
    joints = {joint.name: joint for joint in describe(FRANKA).joints}
    assert list(joints) == list(FRANKA.joint_names)
    for cfg in FRANKA.joints:
        drive = joints[cfg.name].drive
        assert (drive.kp, drive.kd, drive.max_force) == (cfg.kp, cfg.kd, cfg.force_limit)
        assert joints[cfg.name].range == cfg.range


def test_joints_keep_limits_damping_armature_and_what_they_follow(hard_robot):
    path = convert(hard_robot)
    pan = joint_of(path, "pan")
    assert pan.get("type") == "revolute"
    assert (number(pan, "limit", "lower"), number(pan, "limit", "upper")) == (-1.0, 2.0)
    assert (number(pan, "limit", "effort"), number(pan, "dynamics", "damping")) == (20.0, 3.0)
    assert joint_of(path, "tilt").get("type") == "continuous"
    assert number(joint_of(path, "slide"), "dynamics", "friction") == 0.5
    assert number(joint_of(path, "finger"), "limit", "effort") == 10.0
    transmission = ET.parse(path).getroot().find("transmission")
    assert transmission.get("name") == "pan_transmission"
    (armature,) = [item for item in transmission.iter() if item.tag.endswith("rotor_inertia")]
    assert float(armature.get("value")) == 0.4
    # thumb - 0.2 = 0.1 + 5 finger, and 2 (thumb - 0.2) - nail = 0
    thumb, nail = joint_of(path, "thumb"), joint_of(path, "nail")
    assert number(thumb, "mimic", "multiplier") == pytest.approx(5.0)
    assert number(thumb, "mimic", "offset") == pytest.approx(0.3)
    assert number(nail, "mimic", "multiplier") == pytest.approx(2.0)
    assert number(nail, "mimic", "offset") == pytest.approx(-0.4)


def test_visual_meshes_keep_textures_and_collision_meshes_are_convex(hard_robot):
    path = convert(hard_robot)
    links = {link.get("name"): link for link in ET.parse(path).getroot().findall("link")}
    body = links["two axes"]
    (visual,) = body.findall("visual")
    obj = path.parent / visual.find("geometry/mesh").get("filename")
    lines = obj.read_text().splitlines()
    coordinates = [tuple(map(float, line.split()[1:])) for line in lines if line.startswith("vt ")]
    assert {(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.25, 0.75)} == set(coordinates)
    corners = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert np.ptp(corners, axis=0).max() == pytest.approx(0.2 * np.sqrt(2), rel=0.35)  # scaled by two
    mtl = obj.with_suffix(".mtl").read_text()
    assert "map_Kd" in mtl and (obj.with_suffix(".png")).is_file()
    assert "Kd 1 0.5 1" in mtl
    (hull,) = body.findall("collision")
    stone = (path.parent / hull.find("geometry/mesh").get("filename")).read_text()
    assert sum(line.startswith("v ") for line in stone.splitlines()) == 4  # the fifth is inside
    assert len(links["finger"].findall("collision")) == 3  # a capsule: a cylinder and two spheres


def test_a_ball_joint_is_refused_in_urdf_and_written_in_usd(tmp_path, monkeypatch):
    pytest.importorskip("pxr")
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "ball.xml"
    file.write_text(
        "<mujoco><worldbody><body name='arm'><joint name='shoulder' type='ball'/><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )
    with pytest.raises(ConfigError, match=r"URDF has no ball joint, and 'ball' has one \('shoulder'\)"):
        convert(file)
    from pxr import Usd

    stage = Usd.Stage.Open(str(convert(file, "usd")))
    assert stage.GetPrimAtPath("/ball/joints/shoulder").GetTypeName() == "PhysicsSphericalJoint"


def test_usd_has_rigid_bodies_drives_and_textures(hard_robot):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    path = convert(hard_robot, "usd")
    stage = Usd.Stage.Open(str(path))
    root = stage.GetDefaultPrim()
    assert root.HasAPI(UsdPhysics.ArticulationRootAPI)
    bodies = [prim.GetDisplayName() for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.RigidBodyAPI)]
    assert {"base", "two axes", "finger", "thumb", "nail"} <= set(bodies) and "tip" not in bodies
    pan = stage.GetPrimAtPath("/hard/joints/pan")
    drive = UsdPhysics.DriveAPI(pan, "angular")
    assert drive.GetStiffnessAttr().Get() == pytest.approx(100 * np.pi / 180)
    assert drive.GetMaxForceAttr().Get() == 20.0
    assert UsdPhysics.RevoluteJoint(pan).GetUpperLimitAttr().Get() == pytest.approx(np.degrees(2.0))
    assert pan.GetAttribute("mjc:armature").Get() == 0.4
    nail = stage.GetPrimAtPath("/hard/joints/nail")
    assert nail.GetAttribute("newton:mimicCoef1").Get() == pytest.approx(2.0)
    meshes = [prim for prim in stage.Traverse() if prim.GetTypeName() == "Mesh"]
    textured = [mesh for mesh in meshes if UsdGeom.PrimvarsAPI(mesh).HasPrimvar("st")]
    assert [mesh.GetDisplayName() for mesh in textured] == ["visual_wedge"]
    assert len(list((path.parent / "textures").glob("*.png"))) == 1


def test_a_robot_that_floats_has_its_body_as_root(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "floating.xml"
    body = "<body name='{0}' pos='0 0 1'><freejoint/><geom size='.1'/></body>"
    file.write_text(f"<mujoco><worldbody>{body.format('torso')}</worldbody></mujoco>")
    description = describe(file)
    assert description.floating and [link.name for link in description.links] == ["torso"]
    assert "torso" in convert(file).read_text()
    file.write_text(f"<mujoco><worldbody>{body.format('one')}{body.format('two')}</worldbody></mujoco>")
    with pytest.raises(ConfigError, match=r"2 separate bodies \(one, two\).*root=one"):
        convert(file)
    assert [link.name for link in describe(file, root="two").links] == ["two"]


def test_the_result_is_cached_by_content(hard_robot):
    first = convert(hard_robot)
    assert convert(hard_robot) == first
    hard_robot.write_text(hard_robot.read_text().replace('damping="3"', 'damping="4"'))
    assert convert(hard_robot) != first


def test_a_folder_in_use_is_refused_and_an_empty_one_is_taken(hard_robot, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    assert convert(hard_robot, out=empty) == empty / "hard.urdf"
    with pytest.raises(ConfigError, match=r"out=.*empty exists already and is not an empty folder"):
        convert(hard_robot, out=empty)


def test_names_that_do_not_exist_are_refused(hard_robot):
    with pytest.raises(UnknownNameError, match=r"Unknown format 'udf'.*Did you mean 'urdf'"):
        convert(hard_robot, "udf")
    with pytest.raises(UnknownNameError, match=r"Unknown robot 'frnka'.*Did you mean 'franka'"):
        convert("frnka")
    with pytest.raises(UnknownNameError, match=r"Unknown body of hard.xml 'bse'.*Did you mean 'base'"):
        convert(hard_robot, root="bse")
    with pytest.raises(ConfigError, match="does not exist"):
        convert(hard_robot.with_name("absent.xml"))


def test_an_image_that_cannot_be_aligned_is_reported_each_time(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "painted.xml"
    file.write_text(
        "<mujoco><asset><texture name='t' type='2d' builtin='flat' rgb1='1 0 0' width='4' height='4'/>"
        "<material name='paint' texture='t'/></asset><worldbody><body name='b'>"
        "<geom type='box' size='.1 .1 .1' material='paint'/></body></worldbody></mujoco>"
    )
    for _ in range(2):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            path = convert(file)
        assert "The image of material 'paint' cannot be aligned on a primitive shape" in caplog.text
    assert 'rgba="1 0 0 1"' in path.read_text()


def test_bodies_that_never_touch_are_reported_where_a_format_cannot_say_so(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    convert("sawyer_panda")
    assert "sawyer_panda to urdf: Contact pairs and exclusions of bodies are left out." in caplog.text
    caplog.clear()
    path = convert("sawyer_panda", to="mjcf")
    assert "left out" not in caplog.text
    (pair,) = ET.parse(path).getroot().iter("exclude")
    assert pair.get("body1") == "sawyer_panda/right_arm_base_link"


def test_an_msh_lends_its_textured_twins_coordinates(hard_robot, tmp_path):
    import trimesh

    # The same wedge without coordinates, beside the .obj that has them.
    wedge = trimesh.load_mesh(tmp_path / "wedge.obj", process=False)
    wedge.export(tmp_path / "wedge.stl")
    hard_robot.write_text(hard_robot.read_text().replace('file="wedge.obj"', 'file="wedge.stl"'))
    (look,) = [
        s for s, role in describe(hard_robot).shapes() if s.mesh is not None and s.mesh.name == "wedge"
    ][:1]
    assert look.mesh.uvs is not None and look.material.image is not None
    # One that has another shape lends nothing.
    other = tmp_path / "wedge.obj"
    other.write_text(other.read_text().replace("v 0 0 0.1", "v 0 0 0.3"))
    description = describe(hard_robot)
    assert any("wedge.obj has another shape than wedge.stl" in loss for loss in description.losses)
    assert any("'checked' cannot be aligned on mesh 'wedge'" in loss for loss in description.losses)


def test_urdf_round_trips_to_mjcf(hard_robot, tmp_path):
    import mujoco

    urdf = convert(hard_robot, out=tmp_path / "urdf")
    mjcf = convert(urdf, "mjcf", out=tmp_path / "mjcf")
    there, back = mujoco.MjModel.from_xml_path(str(hard_robot)), mujoco.MjModel.from_xml_path(str(mjcf))
    joints = [there.joint(index).name for index in range(there.njnt)]
    assert sorted(joints) == sorted(back.joint(index).name for index in range(back.njnt))
    assert back.body_mass.sum() == pytest.approx(there.body_mass.sum(), abs=1e-6)
    loaded = load(hard_robot)
    errors, note = compare(loaded, describe_loaded(loaded), MujocoReader(mjcf), 50)
    assert errors.passed, note
    assert (back.nu, back.actuator("pan").gainprm[0]) == (2, 100.0)
    assert back.dof_armature[back.joint("pan").dofadr] == pytest.approx(0.4)


FLOATING = """
<mujoco model="flyer">
  <worldbody>
    <body name="trunk">
      <freejoint/>
      <geom type="box" size=".1 .1 .1" mass="2"/>
      <body name="leg" pos="0 0 -0.2">
        <joint name="hip" axis="0 1 0" range="-1 1" armature="0.12"/>
        <geom type="sphere" size=".05" mass=".3"/>
        <body name="tail" pos="0 0 -0.1">
          <joint name="tail" axis="1 0 0"/>
          <geom type="sphere" size=".02" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="cord"><joint joint="hip" coef="1"/><joint joint="tail" coef="1"/></fixed></tendon>
  <actuator>
    <general name="hip" joint="hip" gear="3" gainprm="7" biasprm="1 -2 -3" biastype="affine" ctrlrange="-2 2"
      ctrllimited="true" forcerange="-9 9" forcelimited="true" dyntype="filter" dynprm="0.05"/>
    <motor name="pull" tendon="cord"/>
  </actuator>
</mujoco>
"""


def test_actuators_armature_and_a_free_base_come_back_from_urdf(tmp_path):
    import json

    import mujoco

    source = tmp_path / "flyer.xml"
    source.write_text(FLOATING)
    urdf = convert(source, out=tmp_path / "urdf")
    there = mujoco.MjModel.from_xml_path(str(source))
    back = mujoco.MjModel.from_xml_path(str(convert(urdf, "mjcf", out=tmp_path / "mjcf")))
    assert (back.nq, back.nv, back.nu) == (there.nq, there.nv, 1)
    assert back.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert back.dof_armature[back.joint("hip").dofadr] == pytest.approx(0.12)
    fields = [name for name in dir(there) if name.startswith("actuator_") and name not in _PLACES]
    for name in fields:
        assert np.allclose(getattr(back, name)[0], getattr(there, name)[0]), name
    losses = json.loads((tmp_path / "urdf" / "losses.json").read_text())
    assert "Actuator 'pull' acts on no joint and is left out." in losses


_PLACES = ("actuator_trnid", "actuator_user", "actuator_plugin", "actuator_actadr")
"""Numbers that count other things of the model."""


def test_a_file_of_actuators_of_another_robot_is_refused(tmp_path):
    source = tmp_path / "flyer.xml"
    source.write_text(FLOATING)
    urdf = convert(source, out=tmp_path / "urdf")
    sidecar = urdf.with_suffix(".mujoco.json")
    sidecar.write_text(sidecar.read_text().replace('"hip"', '"knee"'))
    with pytest.raises(ConfigError, match=r"does not fit 'flyer.urdf': there is no joint 'knee'. Convert"):
        convert(urdf, "mjcf", out=tmp_path / "mjcf")
    sidecar.write_text("{}")
    with pytest.raises(ConfigError, match=r"does not fit 'flyer.urdf'"):
        convert(urdf, "mjcf", out=tmp_path / "mjcf")


PACKAGED = """
<robot name="arm">
  <link name="base">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><mesh filename="package://arm_parts/look/base.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm_parts/meshes/base.obj"/></geometry></collision>
  </link>
</robot>
"""
_SOLID = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.mark.parametrize("place", ["above", "given"])
def test_meshes_of_ros_packages_are_found_above_the_file_or_in_the_given_folder(place, tmp_path):
    import mujoco

    urdf = tmp_path / "ws" / "arm_parts" / "urdf" / "arm.urdf"
    packages = tmp_path / "ws" if place == "above" else tmp_path / "elsewhere"
    for folder in (urdf.parent, packages / "arm_parts" / "meshes"):
        folder.mkdir(parents=True)
    urdf.write_text(PACKAGED)
    (packages / "arm_parts" / "meshes" / "base.obj").write_text(_SOLID)
    given = None if place == "above" else packages
    model = mujoco.MjModel.from_xml_path(str(convert(urdf, "mjcf", out=tmp_path / "out", packages=given)))
    assert model.nmesh == 1


def test_a_ros_package_that_is_not_found_is_named_with_the_key_to_use(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(PACKAGED)
    message = r"no 'arm_parts/meshes/base.obj'. Name the folder that holds the package 'arm_parts': packages="
    with pytest.raises(ConfigError, match=message):
        convert(urdf, "mjcf")
    with pytest.raises(ConfigError, match=rf"in '{tmp_path}' is {message}"):
        convert(urdf, "mjcf", packages=tmp_path)


@pytest.mark.parametrize(("compiler", "num_losses"), [("", 1), ('<compiler discardvisual="false"/>', 0)])
def test_visual_shapes_that_mujoco_does_not_read_are_listed(compiler, num_losses, tmp_path):
    urdf = tmp_path / "arm.urdf"
    shape = "<geometry><box size='1 1 1'/></geometry>"
    both = f"<visual>{shape}</visual><collision>{shape}</collision>"
    urdf.write_text(f"<robot name='arm'><mujoco>{compiler}</mujoco><link name='base'>{both}</link></robot>")
    out = convert(urdf, to="mjcf", out=tmp_path / "out")
    losses = json.loads((tmp_path / "out/losses.json").read_text())
    assert len(losses) == num_losses and all("Visual shapes (1) are left out." in loss for loss in losses)
    assert mujoco.MjModel.from_xml_path(str(out)).ngeom == 2 - num_losses


def test_usd_is_refused_as_a_source_in_words(tmp_path):
    (tmp_path / "robot.usda").write_text("#usda 1.0\n")
    with pytest.raises(ConfigError, match=r"is USD, which is written and not read. Give the robot's MJCF or"):
        convert(tmp_path / "robot.usda", "mjcf")


@pytest.mark.slow
def test_a_robot_with_its_gripper_is_one_mjcf_file(tmp_path):
    import mujoco

    path = convert("franka", "mjcf", out=tmp_path / "mjcf")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.njnt, model.nu) == (9, 9)
    assert str(tmp_path) not in path.read_text()


@pytest.mark.parametrize("pitch", [0.0, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-6, 1.2])
def test_roll_pitch_yaw_is_exact_at_a_right_angle_too(pitch):
    quat = from_euler(np.array([0.7, pitch, -0.4]))
    again = from_euler(roll_pitch_yaw(quat)[::-1])
    np.testing.assert_allclose(to_matrix(again), to_matrix(quat), atol=1e-9)


def test_a_convex_hull_is_closed_and_turned_outwards():
    import trimesh

    rng = np.random.default_rng(0)
    hull = convex_hull("cloud", rng.normal(size=(200, 3)))
    solid = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    assert solid.is_watertight and solid.volume > 0
    flat = convex_hull("sheet", np.concatenate([rng.normal(size=(20, 2)), np.zeros((20, 1))], axis=1))
    assert len(flat.faces) >= 4


def test_meshes_of_one_name_get_files_of_their_own(tmp_path):
    one, other = (convex_hull("a/b", np.random.default_rng(seed).normal(size=(9, 3))) for seed in (0, 1))
    names = mesh_files(tmp_path, [(one, None), (other, None), (one, None)])
    assert sorted(names.values()) == ["a_b.obj", "a_b_2.obj"]
