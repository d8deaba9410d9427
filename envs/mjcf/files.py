"""MJCF files of robots and objects, reduced to what a scene takes from them."""

from collections.abc import Collection

import mujoco

from envs.core.assets import resolve
from envs.core.errors import ConfigError

_BY_BODIES = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
_SITE = mujoco.mjtObj.mjOBJ_SITE


def read(
    scene: mujoco.MjSpec, reference: str, sites: Collection[str] = (), *, equalities: bool = False
) -> mujoco.MjSpec:
    """Reads a file with the options of a scene; see :func:`parsed` and :func:`take_options`."""
    spec = parsed(reference, sites, equalities=equalities)
    take_options(spec, scene)
    return spec


def parsed(reference: str, sites: Collection[str] = (), *, equalities: bool = False) -> mujoco.MjSpec:
    """Reads a file, but none of what drives or watches its bodies, and only the named sites.

    Equality constraints, and the sites that they tie, stay where ``equalities`` says so. A mesh of another
    package is named as an asset is, ``package:path``.

    Raises:
        MissingExtraError: if it is of a package that is not installed.
        ConfigError: if there is no such file, or MuJoCo cannot read it.
    """
    path = resolve(reference)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:  # its message has lines, some of them empty
        raise ConfigError(f"'{reference}' is no MJCF file: {' '.join(str(error).split())}") from error
    for mesh in spec.meshes:
        if ":" in mesh.file:  # of another package, as in "robosuite:models/…"
            mesh.file = str(resolve(mesh.file))
    kept = {*sites}
    for tie in spec.equalities if equalities else ():
        kept |= {tie.name1, tie.name2} if tie.objtype == _SITE else set()
    others = [site for site in spec.sites if site.name not in kept]
    ties = [] if equalities else spec.equalities
    for item in (*spec.cameras, *spec.lights, *spec.sensors, *spec.actuators, *ties, *others):
        spec.delete(item)
    return spec


def take_options(spec: mujoco.MjSpec, scene: mujoco.MjSpec) -> None:
    """Replaces a file's options of simulation and rendering by the scene's.

    Where they differ, MuJoCo warns of each when the file is attached.
    """
    visual, ours = spec.visual, scene.visual
    parts = ((visual.map, ours.map), (visual.quality, ours.quality), (visual.global_, ours.global_))
    for own, other in ((spec.option, scene.option), *parts):
        for name in dir(own):
            if not name.startswith("_") and not callable(getattr(own, name)):
                setattr(own, name, getattr(other, name))


def keep_only(spec: mujoco.MjSpec, body) -> None:
    """Deletes the file's other bodies, and meshes, materials and images that nothing uses any more.

    What is attached to a scene brings all of its file's, used or not.
    """
    kept, last = {body.name}, body
    while body.parent is not None:
        body = body.parent
        kept.add(body.name)
    for other in list(spec.worldbody.bodies):
        if other.name not in kept:
            spec.delete(other)
    _delete_ties_to_others(spec, last)
    geoms = list(spec.geoms)
    _delete_others(spec, spec.meshes, {geom.meshname for geom in geoms})
    _delete_others(spec, spec.materials, {geom.material for geom in geoms})
    images = {name for material in spec.materials for name in material.textures}
    _delete_others(spec, spec.textures, images)


def _delete_ties_to_others(spec: mujoco.MjSpec, root) -> None:
    """Deletes equality constraints with what is not part of a body.

    Raises:
        ConfigError: if one ties a part of it to the world.
    """
    bodies = [root]
    for body in bodies:
        bodies += body.bodies
    joints = {joint.name for body in bodies for joint in body.joints}
    sites = {site.name for body in bodies for site in body.sites}
    own = {body.name for body in bodies}
    for tie in list(spec.equalities):
        if tie.type in _BY_BODIES:
            parts = sites if tie.objtype == _SITE else own
        else:
            parts = joints if tie.type == mujoco.mjtEq.mjEQ_JOINT else {item.name for item in spec.tendons}
        ends = [name for name in (tie.name1, tie.name2) if name not in ("", "world")]
        if not all(name in parts for name in ends):
            spec.delete(tie)
        elif tie.type in _BY_BODIES and len(ends) < 2:
            raise ConfigError(
                f"The object's file ties '{ends[0]}' to the world; an object is put elsewhere, and takes "
                f"what it is tied to along. Tie it to the object's root, '{root.name}'."
            )


def _delete_others(spec: mujoco.MjSpec, items: list, used: set[str]) -> None:
    for item in list(items):
        if item.name not in used:
            spec.delete(item)
