"""Compiles a :class:`~envs.scenario.ScenarioCfg` to a ``mujoco.MjModel``.

One compiled model serves every appearance of a level: it has a material and a texture slot per surface, a
slot per light, and a table top that can be turned.
"""

import mujoco
import numpy as np

from envs.core.assets import resolve
from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.contact_exclusions import pairs_never_in_contact
from envs.mjcf.files import keep_only, read
from envs.mjcf.furniture import add_furniture_slots
from envs.mjcf.meshes import VISUAL_GROUP, simplify_visuals
from envs.mjcf.objects import HIDDEN_GROUP, SCENE_GROUP, SHAPES, add_object, add_pull
from envs.mjcf.settings import MujocoSettings
from envs.rotations import look_at_matrix
from envs.scenario import (
    GROUND,
    IDENTITY,
    SURFACES,
    BodyCfg,
    CameraCfg,
    ObjectCfg,
    PhysicsCfg,
    RobotCfg,
    ScenarioCfg,
)
from envs.scenario.places import WALL_HALF_THICKNESS_M

LEAST_LIGHTS = 8
"""Slots for lights that every model has; dark ones cost nothing."""

TEXTURE_SIZE = 256
"""Side of a surface's texture, pixels."""

TABLE_BODY = "table_top"

OBJECT_MATERIAL = "objects"

ROOT_JOINT = "root"
"""Name of the free joint of a robot whose base is not bolted down."""

GRIPPER_PREFIX = "gripper/"
"""Prefix of the names of a gripper's joints and sites."""

MAX_FACES_PER_BODY = 2000
"""Visual triangles of one robot link. At 256 pixels the difference from 20,000 is below one grey level."""


def build_model(scenario: ScenarioCfg, *, simplify: bool = True) -> mujoco.MjModel:
    """Compiles the scenario.

    Args:
        scenario: The scene.
        simplify: Render the robots with merged and simplified visual meshes.

    Returns:
        The model; robots' names are prefixed by ``<robot>/``.
    """
    return _for_rendering(_scene_spec(scenario, simplify))


def build_models(
    scenario: ScenarioCfg, *, simplify: bool = True, prune: bool = False
) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """Compiles the scenario twice: for rendering, and for simulation.

    The second has no visual geoms. Its states are bit-identical to the first's, and a step is 10 % faster;
    bodies, joints, sites, sensors and actuators have the same ids in both.

    Args:
        scenario: The scene.
        simplify: Render the robots with simplified meshes.
        prune: Do not look for contacts of bodies that cannot touch; see
            :mod:`envs.mjcf.contact_exclusions`.
    """
    spec = _scene_spec(scenario, simplify)
    rendered = _for_rendering(spec)
    spec.compiler.discardvisual = True
    simulated = spec.compile()
    apart = pairs_never_in_contact(simulated) if prune else []
    for one, other in apart:
        spec.add_exclude(bodyname1=one, bodyname2=other)
    return rendered, spec.compile() if apart else simulated


def _for_rendering(spec: mujoco.MjSpec) -> mujoco.MjModel:
    model = spec.compile()
    # Robots and objects keep their colours and share one material, which says how they reflect.
    seen = np.isin(model.geom_group, (VISUAL_GROUP, SCENE_GROUP))
    model.geom_matid[seen & (model.geom_matid < 0)] = model.material(OBJECT_MATERIAL).id
    return model


def _scene_spec(scenario: ScenarioCfg, simplify: bool) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    _set_physics(spec, scenario.physics)
    MujocoSettings.of(scenario).write(spec.option)
    _add_surfaces(spec, scenario)
    for index in range(light_slots(scenario)):
        spec.worldbody.add_light(name=f"light{index}", active=False, castshadow=index == 0)
    for robot in scenario.robots:
        _add_robot(spec, robot, simplify)
    for item in scenario.objects:
        add_object(spec, item)
    for item in scenario.objects:
        add_pull(spec, item)
    for camera in scenario.cameras:
        _add_camera(spec, camera)
    for item in (*scenario.robots, *scenario.objects):
        _add_touches(spec, scenario, item)
    spec.add_material(name=OBJECT_MATERIAL)
    return spec


def light_slots(scenario: ScenarioCfg) -> int:
    """Returns how many lights an appearance may have: the scenario's own or those of the lighting channel."""
    return max(LEAST_LIGHTS, len(scenario.appearance.lights), 1 + scenario.lighting.num_lamps)


def robot_spec(robot: RobotCfg, *, simplify: bool = False) -> mujoco.MjSpec:
    """Returns a robot alone, with its gripper, ranges and actuators, as in a scene.

    Args:
        robot: The robot; its names are prefixed by ``<robot>/``.
        simplify: Merge and simplify its visual meshes.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _add_robot(spec, robot, simplify)
    return spec


def _set_physics(spec: mujoco.MjSpec, physics: PhysicsCfg) -> None:
    spec.compiler.degree = False
    option = spec.option
    option.timestep = physics.timestep_s
    option.gravity = physics.gravity
    spec.stat.extent = 2.0
    spec.stat.center = (0.0, 0.0, 0.0)
    spec.visual.map.znear = 0.005
    spec.visual.map.zfar = 20.0
    spec.visual.headlight.active = 0
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 2048
    spec.visual.global_.offwidth = spec.visual.global_.offheight = 1024


def _add_surfaces(spec: mujoco.MjSpec, scenario: ScenarioCfg) -> None:
    for surface in SURFACES:
        spec.add_texture(
            name=surface,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=(1, 1, 1),
            rgb2=(1, 1, 1),
            width=TEXTURE_SIZE,
            height=TEXTURE_SIZE,
        )
        material = spec.add_material(name=surface)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = surface
    world, table, room = spec.worldbody, scenario.table, scenario.room
    ground_z = scenario.floor_z
    half = scenario.ground_half_size_m if room is None else room.half_size_m
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(half, half, 0.1),
        pos=(0, 0, ground_z),
        material="ground",
        group=SCENE_GROUP,
    )
    if room is not None:
        _add_walls(spec, half, room.height_m, ground_z)
        add_furniture_slots(spec, room.half_size_m, ground_z)
    if table is not None:
        size = (*table.half_size, table.thickness_m / 2)
        centre = (table.pos[0], table.pos[1], table.pos[2] - table.thickness_m / 2)
        if table.collides:
            world.add_geom(name="table_collision", type=SHAPES["box"], size=size, pos=centre, group=0)
        top = world.add_body(name=TABLE_BODY, pos=centre, mocap=True)
        group = SCENE_GROUP if table.visible else HIDDEN_GROUP
        seen = {"contype": 0, "conaffinity": 0, "group": group, "material": "table"}
        top.add_geom(name="table", type=SHAPES["box"], size=size, **seen)
        reach_x, reach_y = table.half_size[0] - 0.08, table.half_size[1] - 0.08
        leg = (table.height_m - table.thickness_m) / 2
        for sign_x in (-1, 1):
            for sign_y in (-1, 1):
                top.add_geom(
                    type=SHAPES["box"],
                    size=(0.04, 0.04, leg),
                    pos=(sign_x * reach_x, sign_y * reach_y, -leg - table.thickness_m / 2),
                    **seen,
                )


def _add_walls(spec: mujoco.MjSpec, half: float, height: float, ground_z: float) -> None:
    thickness = WALL_HALF_THICKNESS_M
    for name, x, y in (("x+", 1, 0), ("x-", -1, 0), ("y+", 0, 1), ("y-", 0, -1)):
        spec.worldbody.add_geom(
            name=f"wall_{name}",
            type=SHAPES["box"],
            size=(thickness if x else half, thickness if y else half, height / 2),
            pos=(x * half, y * half, ground_z + height / 2),
            material="wall",
            contype=0,
            conaffinity=0,
            group=SCENE_GROUP,
        )


def touch_sensor(feeling: str, felt: str) -> str:
    """Returns the name of the sensor of whether something touches a robot or an object."""
    return f"{feeling}/touched_by/{felt}"


def _add_touches(spec: mujoco.MjSpec, scenario: ScenarioCfg, item: RobotCfg | ObjectCfg) -> None:
    """Adds a sensor for each thing that a robot or an object feels: how many of their geoms touch."""
    roots = {robot.name: f"{robot.name}/{robot.root}" for robot in scenario.robots}
    for other in item.feels:
        is_ground = other == GROUND
        sensor = spec.add_sensor(
            name=touch_sensor(item.name, other),
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=roots.get(item.name, item.name),
            reftype=mujoco.mjtObj.mjOBJ_GEOM if is_ground else mujoco.mjtObj.mjOBJ_XBODY,
            refname=GROUND if is_ground else roots.get(other, other),
        )
        sensor.intprm[:3] = (1, 0, 1)  # found, as they come, one


def _add_camera(spec: mujoco.MjSpec, camera: CameraCfg) -> None:
    body = spec.worldbody if camera.mount is None else spec.body(camera.mount)
    if body is None:
        names = [body.name for body in spec.bodies]
        raise unknown_name(f"body that carries the camera '{camera.name}'", str(camera.mount), names)
    going_along = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    body.add_camera(
        name=camera.name,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_FIXED if camera.turns else going_along,
        pos=camera.pos,
        quat=camera_quat(camera),
        fovy=camera.fovy_deg,
        resolution=(camera.width, camera.height),
    )


def camera_quat(camera: CameraCfg) -> np.ndarray:
    """Returns the orientation of a camera in the frame of what carries it, wxyz."""
    quat = np.zeros(4)
    matrix = look_at_matrix(np.array(camera.pos), np.array(camera.look_at), camera.up)
    mujoco.mju_mat2Quat(quat, matrix.ravel())
    return quat


def _add_robot(spec: mujoco.MjSpec, robot: RobotCfg, simplify: bool) -> None:
    sites = {robot.ee_site, robot.ee_site.removeprefix(GRIPPER_PREFIX)}
    arm = _load(spec, robot.mjcf, robot.root, sites, simplify, hollow=robot.hollow_meshes)
    gripper_in_degrees = arm.compiler.degree
    if robot.gripper_mjcf is not None:
        # Without its equality constraints a gripper of closed loops falls apart.
        gripper = _load(spec, robot.gripper_mjcf, robot.gripper_root, sites, simplify, equalities=True)
        gripper_in_degrees = gripper.compiler.degree
        mount = arm.body(robot.gripper_mount)
        if mount is None:
            raise ConfigError(f"Robot '{robot.name}': '{robot.mjcf}' has no body '{robot.gripper_mount}'.")
        mount.add_frame().attach_body(gripper.body(robot.gripper_root), GRIPPER_PREFIX, "")
    for body in arm.bodies:
        if robot.gravity_compensated and body.name != "world":
            body.gravcomp = 1.0
    for body in robot.bodies:
        _replace_body(arm, robot, body)
    for site in robot.sites:
        _body_of(arm, robot, site.body).add_site(name=site.name, pos=site.pos)
    if arm.site(robot.ee_site) is None:
        _add_site_at_body(arm, robot)
    _set_joints(arm, robot, gripper_in_degrees)
    _refuse_undeclared_joints(arm, robot)
    if not robot.fixed_base:
        _free_base(arm, robot.root)
    frame = spec.worldbody.add_frame(pos=robot.pos, quat=robot.rot)
    frame.attach_body(arm.body(robot.root), f"{robot.name}/", "")


def _body_of(spec: mujoco.MjSpec, robot: RobotCfg, name: str):
    body = spec.body(name)
    if body is None:
        names = [item.name for item in spec.bodies if item.name != "world"]
        raise unknown_name(f"body of robot '{robot.name}'", name, names)
    return body


def _replace_body(spec: mujoco.MjSpec, robot: RobotCfg, cfg: BodyCfg) -> None:
    body = _body_of(spec, robot, cfg.name)
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = cfg.mass_kg, cfg.com, cfg.inertia_rot, cfg.inertia
    if not cfg.hull:
        return
    for geom in body.geoms:
        if geom.contype or geom.conaffinity:
            spec.delete(geom)
    name = f"{cfg.name}_hull"
    spec.add_mesh(name=name, uservert=np.ravel(cfg.hull))
    body.add_geom(type=SHAPES["mesh"], meshname=name, group=HIDDEN_GROUP)


def _free_base(spec: mujoco.MjSpec, root: str) -> None:
    """Adds a free joint to a robot's root; at rest it is where the robot is placed."""
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    body = spec.body(root)
    body.pos, body.quat = np.zeros(3), np.array(IDENTITY)
    body.add_freejoint(name=ROOT_JOINT)


def _add_site_at_body(spec: mujoco.MjSpec, robot: RobotCfg) -> None:
    body = spec.body(robot.ee_site)
    if body is None:
        names = [item.name for item in (*spec.sites, *spec.bodies) if item.name != "world"]
        raise unknown_name(f"end effector (ee_site) of robot '{robot.name}'", robot.ee_site, names)
    body.add_site(name=robot.ee_site)


def _load(
    scene: mujoco.MjSpec,
    reference: str,
    root: str | None,
    sites: set[str],
    simplify: bool,
    *,
    hollow: bool = False,
    equalities: bool = False,
) -> mujoco.MjSpec:
    """Reads one body, and what it carries, of a robot's file, with only the named sites."""
    spec = read(scene, reference, sites, equalities=equalities)
    body = spec.body(root)
    if body is None:
        names = [item.name for item in spec.bodies if item.name != "world"]
        raise unknown_name(f"root of '{reference}'", str(root), names)
    keep_only(spec, body)
    tells_apart = any(geom.group in (VISUAL_GROUP, SCENE_GROUP) for geom in spec.geoms)
    for geom in spec.geoms:
        if not tells_apart:  # what is touched is what is seen
            geom.group = SCENE_GROUP
        if geom.rgba[3] == 0.0:
            geom.group = HIDDEN_GROUP
    for mesh in spec.meshes if hollow else ():
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    if simplify:
        folder = resolve(reference).parent / (spec.meshdir or "")
        simplify_visuals(spec, folder, MAX_FACES_PER_BODY)
    return spec


def _set_joints(spec: mujoco.MjSpec, robot: RobotCfg, gripper_in_degrees: bool) -> None:
    """Sets each joint's range and damping, and adds the actuators of driven ones, in the robot's order.

    What was attached keeps the unit of angles of its own file.
    """
    for cfg in robot.joints:
        joint = spec.joint(cfg.name)
        if joint is None:
            valid = ", ".join(item.name for item in spec.joints)
            raise ConfigError(f"Robot '{robot.name}' has no joint '{cfg.name}'. Its joints: {valid}.")
        if cfg.flip:
            joint.axis = -np.asarray(joint.axis)
        of_gripper = robot.gripper_mjcf is not None and cfg.name.startswith(GRIPPER_PREFIX)
        degrees = gripper_in_degrees if of_gripper else spec.compiler.degree
        in_degrees = degrees and joint.type == mujoco.mjtJoint.mjJNT_HINGE
        joint.range = np.degrees(cfg.range) if in_degrees else cfg.range
        for field in ("damping", "armature", "frictionloss"):
            value = getattr(cfg, field)
            if value is not None:
                setattr(joint, field, value if field != "damping" else [value, 0.0, 0.0])
        if not cfg.driven:
            continue
        actuator = spec.add_actuator(name=cfg.name, target=cfg.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = cfg.kp if cfg.drive == "position" else 1.0
        actuator.biasprm[1], actuator.biasprm[2] = -cfg.kp, -cfg.kd
        actuator.ctrllimited = actuator.forcelimited = 1
        actuator.ctrlrange = cfg.target_range or cfg.range
        actuator.forcerange = (-cfg.force_limit, cfg.force_limit)


def _refuse_undeclared_joints(spec: mujoco.MjSpec, robot: RobotCfg) -> None:
    """Raises ConfigError if the file has joints that no reset would restore."""
    moving = [joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    undeclared = [name for name in moving if name not in robot.joint_names]
    if undeclared:
        raise ConfigError(
            f"Robot '{robot.name}' does not declare the joints {', '.join(undeclared)} of its file, so no "
            "reset would restore them. Add them to its joints; a passive one is JointCfg(..., driven=False)."
        )
