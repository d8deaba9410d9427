"""Objects of a scenario as bodies of a MuJoCo model.

The root body is called after the object, everything inside it ``<object>/<name>``.
"""

import mujoco
import numpy as np

from envs.assets import resolve
from envs.errors import ConfigError
from envs.handlers.mujoco.meshes import VISUAL_GROUP
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg

SCENE_GROUP = 2
"""Geom group of everything that is drawn and is not a robot."""

HIDDEN_GROUP = 0
"""Geom group of what is only touched."""

SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}

_JOINTS = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}


def add_object(spec: mujoco.MjSpec, item: ObjectCfg) -> None:
    """Adds an object; one that does not move under physics is a mocap body, which stays where it is put."""
    root = spec.worldbody.add_body(name=item.name, pos=item.pos, quat=item.rot, mocap=item.kind != "free")
    if item.kind == "free":
        root.add_freejoint(name=item.name)
    seen_only = item.kind == "marker"
    for index, geom in enumerate(item.geoms):
        name = item.name if index == 0 else f"{item.name}/{index}"
        _add_geom(spec, root, geom, name, seen_only)
    bodies = {None: root}
    for link in item.links:
        bodies[link.name] = _add_link(spec, bodies[link.parent], item.name, link, seen_only)
    if item.mjcf is not None:
        _attach_file(root, item, item.mjcf)


def _add_link(spec, parent, object_name: str, link: LinkCfg, seen_only: bool):
    name = f"{object_name}/{link.name}"
    body = parent.add_body(name=name, pos=link.pos, quat=link.rot)
    if link.joint is not None:
        _add_joint(body, name, link.joint)
    for index, geom in enumerate(link.geoms):
        _add_geom(spec, body, geom, name if index == 0 else f"{name}/{index}", seen_only)
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
    )


def _add_geom(spec, body, geom: GeomCfg, name: str, seen_only: bool) -> None:
    added = body.add_geom(
        name=name,
        type=SHAPES[geom.shape],
        pos=geom.pos,
        quat=geom.rot,
        rgba=geom.rgba,
        mass=geom.mass_kg,
        friction=geom.friction,
        condim=4,
        group=SCENE_GROUP if geom.visible else HIDDEN_GROUP,
    )
    if geom.mesh is None:
        added.size = (*geom.size, 0.0, 0.0)[:3]
    else:
        spec.add_mesh(name=name, file=str(resolve(geom.mesh)), scale=geom.size)
        added.meshname = name
    if geom.texture is not None:
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=str(resolve(geom.texture)))
        spec.add_material(name=name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        added.material = name
    if seen_only or not geom.collides:
        added.contype = added.conaffinity = 0


def _attach_file(root, item: ObjectCfg, reference: str) -> None:
    path = resolve(reference)
    spec = mujoco.MjSpec.from_file(str(path))
    for thing in (*spec.cameras, *spec.lights, *spec.sensors, *spec.actuators, *spec.sites):
        spec.delete(thing)
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
    if not any(geom.group in (VISUAL_GROUP, SCENE_GROUP) for geom in spec.geoms):
        for geom in spec.geoms:  # a file that does not tell what is seen from what is touched
            geom.group = SCENE_GROUP
    if item.kind == "marker":
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
    root.add_frame().attach_body(body, f"{item.name}/", "")


def rest_joints(item: ObjectCfg) -> np.ndarray:
    """Returns the rest positions of an object's joints in our order, (J,)."""
    rests = [link.joint.default for link in item.links if link.joint is not None]
    return np.array([*rests, *(0.0 for _ in item.mjcf_joints)])
