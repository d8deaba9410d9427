"""Objects of a scenario as bodies of a MuJoCo model.

The root body is called after the object, everything inside it ``<object>/<name>``.
"""

from typing import Any

import mujoco
import numpy as np
from PIL import Image

from envs.core.assets import resolve
from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.files import keep_only, read
from envs.mjcf.meshes import VISUAL_GROUP
from envs.scenario import IDENTITY, GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg

SCENE_GROUP = 2
"""Geom group of everything visible that is not a robot."""

HIDDEN_GROUP = 0
"""Geom group of what is only touched."""

SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}

_FREE = mujoco.mjtJoint.mjJNT_FREE

MAX_TEXTURE_SIZE = 512
"""Pixels along the longer side of an object's texture. A tracer keeps 16 bytes for each, and an object
that fills an image of 256 pixels shows no more."""

_JOINTS = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}


PULL_TORQUE_SCALE = 5.0
"""Weight of turning against moving, m, of a weld that pulls: Meta-World's (``reset_mocap_welds``)."""

DRY_FRICTION = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of a joint's dry friction. At MuJoCo's default of 0.9 a joint under load creeps by millimetres
in a second; at this, its largest, by micrometres."""


def add_object(spec: mujoco.MjSpec, item: ObjectCfg) -> None:
    """Adds an object; one that does not move under physics is a mocap body, which stays where it is put."""
    file = None if item.mjcf is None else _load(spec, item, item.mjcf)
    if file is not None and item.kind == "free" and any(j.type == _FREE for j in file[1].joints):
        _attach_free(spec, item, file[1])
        return
    root = spec.worldbody.add_body(name=item.name, pos=item.pos, quat=item.rot, mocap=item.kind != "free")
    if item.kind == "free":
        root.add_freejoint(name=item.name)
    seen_only = item.kind == "marker"
    for index, geom in enumerate(item.geoms):
        name = item.name if index == 0 else f"{item.name}/{index}"
        add_geom(spec, root, geom, name, seen_only)
    bodies: dict[str | None, Any] = {None: root}
    for link in item.links:
        bodies[link.name] = _add_link(spec, bodies[link.parent], item.name, link, seen_only)
    if file is not None:
        root.add_frame().attach_body(file[1], f"{item.name}/", "")
        if item.kind == "fixed":
            _let_links_touch_the_root(spec, root)


def add_pull(spec: mujoco.MjSpec, item: ObjectCfg) -> None:
    """Adds the weld of an object that pulls a body, once that body is there."""
    if item.pulls is None:
        return
    if spec.body(item.pulls) is None:
        names = [body.name for body in spec.bodies]
        raise unknown_name(f"body that the object '{item.name}' pulls", item.pulls, names)
    weld = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1=item.name, name2=item.pulls
    )
    # Anchor, place and turn of the body against the object, weight of turning.
    weld.data[:11] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *IDENTITY, PULL_TORQUE_SCALE)


def _add_link(spec, parent, object_name: str, link: LinkCfg, seen_only: bool):
    name = f"{object_name}/{link.name}"
    body = parent.add_body(name=name, pos=link.pos, quat=link.rot)
    if link.joint is not None:
        _add_joint(body, name, link.joint)
    for index, geom in enumerate(link.geoms):
        add_geom(spec, body, geom, name if index == 0 else f"{name}/{index}", seen_only)
    return body


def _add_joint(body, name: str, joint: ObjectJointCfg) -> None:
    body.add_joint(
        name=name,
        type=_JOINTS[joint.kind],
        axis=joint.axis,
        pos=joint.pos,
        range=joint.range,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        damping=[joint.damping, 0.0, 0.0],
        frictionloss=joint.frictionloss,
        stiffness=[joint.stiffness, 0.0, 0.0],
        springref=joint.springref,
        armature=joint.armature,
        solimp_friction=DRY_FRICTION,
    )


def add_geom(spec: mujoco.MjSpec, body: Any, geom: GeomCfg, name: str, seen_only: bool = False) -> None:
    """Adds a geom to a body; one that is ``seen_only`` touches nothing."""
    added = body.add_geom(
        name=name,
        type=SHAPES[geom.shape],
        pos=geom.pos,
        quat=geom.rot,
        rgba=geom.rgba,
        mass=geom.mass_kg,
        friction=geom.friction,
        condim=geom.condim,
        group=SCENE_GROUP if geom.visible else HIDDEN_GROUP,
    )
    if geom.mesh is None:
        added.size = (*geom.size, 0.0, 0.0)[:3]
    else:
        spec.add_mesh(name=name, file=str(resolve(geom.mesh)), scale=geom.size)
        added.meshname = name
    if geom.texture is not None:
        _add_image(spec, name, geom.texture)
        spec.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        added.material = name
    if seen_only or not geom.collides:
        added.contype = added.conaffinity = 0


def _add_image(spec, name: str, reference: str) -> None:
    path = resolve(reference)
    try:
        with Image.open(path) as image:
            image.thumbnail((MAX_TEXTURE_SIZE, MAX_TEXTURE_SIZE))
            pixels = np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ConfigError(
            f"The texture '{reference}' is not an image that can be read: {error}. Replace the file, or name "
            "another one."
        ) from error
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.height, texture.width, texture.nchannel = pixels.shape
    texture.data = pixels.tobytes()


def _load(scene: mujoco.MjSpec, item: ObjectCfg, reference: str) -> tuple:
    """Returns the file's model, which must outlive it, and the body that is the object, at the origin."""
    spec = read(scene, reference, equalities=True)
    if item.mjcf_radians:
        spec.compiler.degree = False
    for index, body in enumerate(spec.bodies):
        body.name = body.name or f"body{index}"
    for joint in spec.joints:
        joint.name = joint.name or joint.parent.name
    body = spec.body(item.mjcf_root) if item.mjcf_root else spec.worldbody.first_body()
    if body is None:
        names = ", ".join(other.name for other in spec.bodies if other.name != "world")
        raise ConfigError(
            f"Object '{item.name}': '{reference}' has no body '{item.mjcf_root}'. Its bodies: {names}."
        )
    joints = [joint.name for joint in spec.joints]
    for name in item.mjcf_joints:
        if name not in joints:
            raise ConfigError(
                f"Object '{item.name}': '{reference}' has no joint '{name}'. Its joints: {', '.join(joints)}."
            )
    body.pos, body.quat = np.zeros(3), np.array(IDENTITY)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # drops Euler angles and the like
    _set_groups(spec, item)
    keep_only(spec, body)
    return spec, body


def _let_links_touch_the_root(spec: mujoco.MjSpec, root) -> None:
    """Pairs the geoms that do not move with those of the links that are jointed to them.

    In their file the object is part of the world, which collides with everything; here it is a body of its
    own, which MuJoCo excludes from contacts with its children.
    """
    still, links = _still_and_links(root)
    for link in links:
        for geom in (geom for body in _still_and_links(link)[0] for geom in body.geoms):
            for other in (other for body in still for other in body.geoms):
                if geom.contype & other.conaffinity or other.contype & geom.conaffinity:
                    _pair(spec, other, geom)


def _pair(spec: mujoco.MjSpec, first, second) -> None:
    """Gives a contact pair its default parameters (MuJoCo documentation, "Contact parameters")."""
    for geom in (first, second):
        geom.name = geom.name or f"{geom.parent.name}/geom{geom.parent.geoms.index(geom)}"
    leading = [g for g in (first, second) if g.priority == max(first.priority, second.priority)]
    slide, spin, roll = np.max([geom.friction for geom in leading], axis=0)
    weights = [geom.solmix for geom in leading]
    spec.add_pair(
        geomname1=first.name,
        geomname2=second.name,
        condim=max(geom.condim for geom in leading),
        friction=(slide, slide, spin, roll, roll),
        solref=np.average([geom.solref for geom in leading], axis=0, weights=weights),
        solimp=np.average([geom.solimp for geom in leading], axis=0, weights=weights),
        margin=max(first.margin, second.margin),
        gap=max(first.gap, second.gap),
    )


def _still_and_links(root) -> tuple[list, list]:
    """Returns a body and what does not move against it, and the links that do, without what they carry."""
    still, links = [root], []
    for body in still:
        for child in body.bodies:
            (links if child.joints else still).append(child)
    return still, links


def _set_groups(spec: mujoco.MjSpec, item: ObjectCfg) -> None:
    shown = item.mjcf_shown
    if shown is None and not any(geom.group in (VISUAL_GROUP, SCENE_GROUP) for geom in spec.geoms):
        shown = range(mujoco.mjNGROUP)  # the file does not separate visual from collision geoms
    for geom in spec.geoms:
        if shown is not None and geom.group in shown and geom.rgba[3] > 0.0:
            geom.group = SCENE_GROUP
        elif geom.group in (VISUAL_GROUP, SCENE_GROUP) and (shown is not None or geom.rgba[3] == 0.0):
            geom.group = HIDDEN_GROUP
        if item.kind == "marker":
            geom.contype = geom.conaffinity = 0


def _attach_free(spec: mujoco.MjSpec, item: ObjectCfg, body) -> None:
    """Attaches a body that has a free joint of its own, and keeps that joint's damping."""
    attached = spec.worldbody.add_frame().attach_body(body, f"{item.name}/", "")
    attached.name, attached.pos, attached.quat = item.name, np.array(item.pos), np.array(item.rot)
    joint = next(joint for joint in attached.joints if joint.type == _FREE)
    joint.name = item.name


def rest_joints(item: ObjectCfg) -> np.ndarray:
    """Returns the rest positions of an object's joints in our order, (J,)."""
    rests = [link.joint.default for link in item.links if link.joint is not None]
    return np.array([*rests, *(0.0 for _ in item.mjcf_joints)])
