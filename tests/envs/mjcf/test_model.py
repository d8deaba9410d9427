"""The compiled model says what the scenario says."""

import dataclasses

import mujoco
import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.mjcf.layout import as_slice, block, layout_of
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.model import LEAST_LIGHTS, OBJECT_MATERIAL, build_model, build_models
from envs.mjcf.objects import SCENE_GROUP
from envs.robots.franka import FRANKA
from envs.scenario import SURFACES, GeomCfg, ObjectCfg, PhysicsCfg, ScenarioCfg
from envs.tasks import TASKS
from envs.tasks.pick_cube import PickCube

SCENARIO = PickCube().scenario
FIXED = ObjectCfg(
    name="post",
    geoms=(GeomCfg(shape="cylinder", size=(0.03, 0.2)),),
    pos=(0.2, 0.1, 0.2),
    rot=(0.0, 0.0, 0.0, 1.0),
    kind="fixed",
)


@pytest.fixture(scope="module")
def model():
    return build_model(dataclasses.replace(SCENARIO, objects=(*SCENARIO.objects, FIXED)))


@pytest.fixture(scope="module")
def layout(model):
    return layout_of(model, dataclasses.replace(SCENARIO, objects=(*SCENARIO.objects, FIXED)))


def test_actuators_are_position_servos_of_the_robots_gains(model):
    for joint in FRANKA.joints:
        actuator = model.actuator(f"franka/{joint.name}")
        assert actuator.gainprm[0] == joint.kp
        assert tuple(actuator.biasprm[:3]) == (0.0, -joint.kp, -joint.kd)
        assert tuple(actuator.forcerange) == (-joint.force_limit, joint.force_limit)
        np.testing.assert_allclose(actuator.ctrlrange, joint.range)
        np.testing.assert_allclose(model.joint(f"franka/{joint.name}").range, joint.range)


def test_there_is_nothing_of_the_robots_file_that_we_did_not_ask_for(model):
    assert model.nu == len(FRANKA.joints)
    assert model.nsensor == 0
    assert [model.camera(i).name for i in range(model.ncam)] == ["front", "wrist"]
    assert model.nlight == LEAST_LIGHTS


def test_gravity_acts_on_objects_and_not_on_the_arm(model):
    arm = [i for i in range(model.nbody) if model.body(i).name.startswith("franka/")]
    assert len(arm) > 8
    assert (model.body_gravcomp[arm] == 1.0).all()
    assert model.body_gravcomp[model.body("cube").id] == 0.0


def test_time_and_gravity():
    physics = PhysicsCfg(timestep_s=0.004, gravity=(0.0, 0.0, -1.62))
    model = build_model(ScenarioCfg(physics=physics))
    assert model.opt.timestep == 0.004
    assert tuple(model.opt.gravity) == (0.0, 0.0, -1.62)


def test_objects_have_their_shape_mass_and_pose(model):
    cube, goal, post = (model.geom(name) for name in ("cube", "goal", "post"))
    assert model.body("cube").mass[0] == pytest.approx(0.064)
    assert tuple(cube.size) == (0.02, 0.02, 0.02)
    assert (int(cube.type[0]), int(goal.type[0]), int(post.type[0])) == (
        int(mujoco.mjtGeom.mjGEOM_BOX),
        int(mujoco.mjtGeom.mjGEOM_SPHERE),
        int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    )
    assert (int(goal.contype[0]), int(goal.conaffinity[0])) == (0, 0)
    np.testing.assert_allclose(model.body("post").pos, FIXED.pos)
    np.testing.assert_allclose(np.abs(model.body("post").quat), np.abs(FIXED.rot))


def test_a_cube_of_that_inertia(model):
    """m a² / 6 for a solid cube of side a."""
    np.testing.assert_allclose(model.body("cube").inertia, 0.064 * 0.04**2 / 6, rtol=1e-6)


def test_every_geom_is_visual_or_collides(model):
    """Group 0 is only touched, the visual group only seen."""
    group = model.geom_group
    assert set(np.unique(group)) == {0, VISUAL_GROUP, SCENE_GROUP}
    visual = group == VISUAL_GROUP
    assert not model.geom_contype[visual].any()
    assert not model.geom_conaffinity[visual].any()
    assert (model.geom_contype[group == 0] | model.geom_conaffinity[group == 0]).all()


def test_surfaces_have_materials_of_their_own_and_the_rest_share_one(model):
    assert model.geom("table").matid[0] == model.material("table").id
    assert model.geom("wall_x+").matid[0] == model.material("wall").id
    assert model.geom("ground").matid[0] == model.material("ground").id
    shared = model.material(OBJECT_MATERIAL).id
    assert {int(model.geom(name).matid[0]) for name in ("cube", "goal", "post")} == {shared}
    np.testing.assert_allclose(model.geom("cube").rgba, SCENARIO.object("cube").geoms[0].rgba)
    assert all(model.texture(surface).nchannel[0] == 3 for surface in SURFACES)


def test_the_table_top_is_the_plane_that_it_says(model):
    table = SCENARIO.table
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in ("table", "table_collision"):
        geom = model.geom(name).id
        assert data.geom_xpos[geom][2] + model.geom_size[geom][2] == pytest.approx(table.pos[2])
        np.testing.assert_allclose(data.geom_xpos[geom][:2], table.pos[:2])
    assert data.geom("ground").xpos[2] == pytest.approx(table.pos[2] - table.height_m)


def test_a_scene_needs_neither_table_nor_room():
    model = build_model(ScenarioCfg(table=None, room=None))
    names = [model.geom(i).name for i in range(model.ngeom)]
    assert names == ["ground"]
    assert model.geom("ground").pos[2] == 0.0


def test_a_camera_has_its_pose_and_size(model):
    cfg = SCENARIO.cameras[0]
    camera = model.camera("front")
    np.testing.assert_allclose(camera.pos, cfg.pos)
    assert camera.fovy[0] == cfg.fovy_deg
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, camera.quat)
    view = -matrix.reshape(3, 3)[:, 2]
    wanted = np.subtract(cfg.look_at, cfg.pos)
    np.testing.assert_allclose(view, wanted / np.linalg.norm(wanted), atol=1e-9)
    assert matrix.reshape(3, 3)[2, 1] > 0  # up is up


def test_an_unknown_joint_is_named_beside_the_valid_ones():
    joints = (dataclasses.replace(FRANKA.joints[0], name="joint9"), *FRANKA.joints[1:])
    robot = dataclasses.replace(FRANKA, joints=joints)
    with pytest.raises(ConfigError, match=r"Robot 'franka' has no joint 'joint9'\. Its joints: joint1"):
        build_model(ScenarioCfg(robots=(robot,)))


def test_an_unknown_gripper_mount_is_named():
    robot = dataclasses.replace(FRANKA, gripper_mount="wrist")
    with pytest.raises(ConfigError, match=r"Robot 'franka': '.*' has no body 'wrist'"):
        build_model(ScenarioCfg(robots=(robot,)))


def test_a_flipped_joint_turns_the_other_way():
    flip = (dataclasses.replace(FRANKA.joints[0], flip=not FRANKA.joints[0].flip), *FRANKA.joints[1:])
    straight = build_model(ScenarioCfg(robots=(FRANKA,)))
    turned = build_model(ScenarioCfg(robots=(dataclasses.replace(FRANKA, joints=flip),)))
    name = f"franka/{FRANKA.joints[0].name}"
    np.testing.assert_allclose(straight.joint(name).axis, -turned.joint(name).axis)


def test_the_layout_finds_every_joint_in_the_scenarios_order(model, layout):
    robot = layout.robots[0]
    for index, name in enumerate(FRANKA.joint_names):
        joint = model.joint(f"franka/{name}")
        assert robot.qpos[index] == joint.qposadr[0]
        assert robot.qvel[index] == joint.dofadr[0]
        assert model.actuator(int(robot.ctrl[index])).name == f"franka/{name}"
    assert model.site(robot.ee_site).name == f"franka/{FRANKA.ee_site}"
    np.testing.assert_allclose(robot.pos, SCENARIO.robots[0].pos)


def test_layout_has_the_kind_of_each_object(model, layout):
    cube, goal, post = layout.objects
    assert (cube.root, goal.root, post.root) == ("free", "mocap", "mocap")
    assert cube.root_qpos == model.joint("cube").qposadr[0]
    assert cube.root_qvel == model.joint("cube").dofadr[0]
    assert (goal.mocap, post.mocap) == (model.body("goal").mocapid[0], model.body("post").mocapid[0])
    assert (goal.root_qpos, post.root_qpos, cube.mocap) == (-1, -1, -1)
    assert len(post.qpos) == len(post.ctrl) == 0


@pytest.mark.parametrize(
    ("addresses", "expected"),
    [([3, 4, 5], slice(3, 6)), ([7], slice(7, 8)), ([0, 1], slice(0, 2))],
)
def test_consecutive_addresses_are_a_slice(addresses, expected):
    assert as_slice(np.array(addresses)) == expected


@pytest.mark.parametrize("addresses", [[], [3, 5], [2, 1], [4, 4]])
def test_other_addresses_stay_as_they_are(addresses):
    given = np.array(addresses, np.intp)
    assert as_slice(given) is given


@pytest.mark.parametrize("rows", [slice(None), np.array([0, 2])])
@pytest.mark.parametrize("columns", [slice(1, 3), np.array([3, 1])])
def test_a_block_is_every_row_in_every_column(rows, columns):
    """Scattered addresses are read and written like consecutive ones."""
    values = np.arange(12.0).reshape(3, 4)
    expected = values[rows][:, columns]
    np.testing.assert_array_equal(values[block(rows, columns)], expected)
    values[block(rows, columns)] = -1.0
    assert (values == -1.0).sum() == expected.size


@pytest.mark.slow
@pytest.mark.parametrize("task", ["PickCube", "CloseBox", "humanoid/sit_hard"])
def test_what_is_only_seen_changes_no_bit_of_what_is_simulated(task):
    drawn, simulated = build_models(TASKS.get(task)().scenario)
    assert simulated.ngeom < drawn.ngeom and simulated.nmat == 0
    for field in ("body_mass", "body_inertia", "body_mocapid", "site_bodyid", "sensor_adr", "qpos0"):
        np.testing.assert_array_equal(getattr(simulated, field), getattr(drawn, field))
    ends = []
    for model in (drawn, simulated):
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 50)
        ends.append(np.concatenate([data.qpos, data.qvel, data.sensordata, data.site_xpos.ravel()]))
    np.testing.assert_array_equal(*ends)
