"""Robots of a scenario as bodies of a MuJoCo model."""

import functools

import mujoco
import numpy as np

from envs.core.assets import FOLDER_PREFIX, resolve
from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.files import keep_only, parsed, take_options
from envs.mjcf.meshes import VISUAL_GROUP, simplify_visuals
from envs.mjcf.objects import HIDDEN_GROUP, SCENE_GROUP, SHAPES, add_geom
from envs.scenario import IDENTITY, BodyCfg, JointCfg, RobotCfg

ROOT_JOINT = "root"
"""Name of the free joint of a robot whose base is not bolted down."""

GRIPPER_PREFIX = "gripper/"
"""Prefix of the names of a gripper's joints and sites."""

TIE_SOLREF, TIE_SOLIMP = (0.005, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of the ties of joints that follow others: that of the loops of Menagerie's 2F-85."""

TOOL_BODY = "tool"
"""Body of a robot's tool."""

MAX_FACES_PER_BODY = 2000
"""Visual triangles of one robot link. At 256 pixels the difference from 20,000 is below one grey level."""


def robot_spec(robot: RobotCfg, *, simplify: bool = False) -> mujoco.MjSpec:
    """Returns a robot alone, with its gripper, ranges and actuators, as in a scene.

    Args:
        robot: The robot; its names are prefixed by ``<robot>/``.
        simplify: Merge and simplify its visual meshes.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, robot, simplify)
    return spec


def add_robot(spec: mujoco.MjSpec, robot: RobotCfg, simplify: bool) -> None:
    """Adds a robot to a scene, with its gripper or tool, ranges and actuators.

    Raises:
        ConfigError: Its file lacks a body or a joint that it names, or has joints that it does not.
    """
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
    if robot.tool:
        _add_tool(arm, robot)
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
    _tie_joints(arm, robot)
    _refuse_undeclared_joints(arm, robot)
    if not robot.fixed_base:
        _free_base(arm, robot.root)
    _keep_apart(arm, robot)
    frame = spec.worldbody.add_frame(pos=robot.pos, quat=robot.rot)
    frame.attach_body(arm.body(robot.root), f"{robot.name}/", "")


def _add_tool(arm: mujoco.MjSpec, robot: RobotCfg) -> None:
    if robot.gripper_mount is None:
        raise ConfigError(f"Robot '{robot.name}' has a tool, and no gripper_mount: name its body.")
    body = _body_of(arm, robot, robot.gripper_mount).add_body(name=TOOL_BODY)
    for index, geom in enumerate(robot.tool):
        add_geom(arm, body, geom, TOOL_BODY if index == 0 else f"{TOOL_BODY}/{index}")


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


def _keep_apart(spec: mujoco.MjSpec, robot: RobotCfg) -> None:
    """Excludes the pairs of bodies that never touch from the tests for contacts."""
    for names in robot.apart:
        one, other = (_body_of(spec, robot, name).name for name in names)
        spec.add_exclude(bodyname1=one, bodyname2=other)


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
    """Returns one body, and what it carries, of a robot's file, with only the named sites."""
    prepare = _prepared_once if _is_of_packages(reference) else _prepared
    prepared = prepare(reference, root, frozenset(sites), simplify, hollow, equalities)
    spec = prepared.copy()
    take_options(spec, scene)
    return spec


def _prepared(
    reference: str, root: str | None, sites: frozenset[str], simplify: bool, hollow: bool, equalities: bool
) -> mujoco.MjSpec:
    """Reads a robot's file and reduces it; the options of simulation and rendering are the file's."""
    spec = parsed(reference, sites, equalities=equalities)
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


_prepared_once = functools.cache(_prepared)


@functools.cache
def _is_of_packages(reference: str) -> bool:
    """Whether a file and its meshes are of installed packages, which stay as they are while a program runs.

    A file of the user's may change, and an asset folder may be another one or gone.
    """
    if ":" not in reference or reference.startswith(FOLDER_PREFIX):
        return False
    return FOLDER_PREFIX not in resolve(reference).read_text(encoding="utf-8", errors="replace")


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
        if cfg.pulls:
            _add_tendon(spec, robot, cfg)
            actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0] = cfg.kp if cfg.drive == "position" else 1.0
        actuator.biasprm[1], actuator.biasprm[2] = -cfg.kp, -cfg.kd
        actuator.ctrllimited = actuator.forcelimited = 1
        actuator.ctrlrange = cfg.target_range or cfg.range
        actuator.forcerange = (-cfg.force_limit, cfg.force_limit)


def _add_tendon(spec: mujoco.MjSpec, robot: RobotCfg, cfg: JointCfg) -> None:
    """Adds the tendon that a joint's actuator pulls, by the joint's name.

    Raises:
        ConfigError: It runs over what is none of the robot's joints, or over one that has an actuator.
    """
    free = [joint.name for joint in robot.joints if not joint.driven]
    tendon = spec.add_tendon(name=cfg.name)
    tendon.wrap_joint(cfg.name, 1.0)
    for name, coefficient in cfg.pulls:
        if name not in free:
            raise unknown_name(
                f"joint without an actuator that '{cfg.name}' of '{robot.name}' pulls", name, free
            )
        tendon.wrap_joint(name, coefficient)


def _tie_joints(spec: mujoco.MjSpec, robot: RobotCfg) -> None:
    """Ties each joint that follows another one to it.

    Raises:
        ConfigError: The other one is none of its joints that are driven.
    """
    leaders = [robot.joint_names[index] for index in robot.driven]
    for cfg in robot.joints:
        if cfg.follows is None:
            continue
        leader, ratio = cfg.follows
        if leader not in leaders:
            raise unknown_name(f"driven joint that '{cfg.name}' of '{robot.name}' follows", leader, leaders)
        tie = spec.add_equality(
            name=f"{cfg.name}_follows",
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=cfg.name,
            name2=leader,
            solref=TIE_SOLREF,
            solimp=TIE_SOLIMP,
        )
        tie.data[:5] = (0.0, ratio, 0.0, 0.0, 0.0)


def _refuse_undeclared_joints(spec: mujoco.MjSpec, robot: RobotCfg) -> None:
    """Raises ConfigError if the file has joints that no reset would restore."""
    moving = [joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    undeclared = [name for name in moving if name not in robot.joint_names]
    if undeclared:
        raise ConfigError(
            f"Robot '{robot.name}' does not declare the joints {', '.join(undeclared)} of its file, so no "
            "reset would restore them. Add them to its joints; a passive one is JointCfg(..., driven=False)."
        )
