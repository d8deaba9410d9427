"""MJCF files of robots and objects, reduced to what a scene takes from them."""

from collections.abc import Collection

import mujoco

from envs.assets import resolve


def read(scene: mujoco.MjSpec, reference: str, sites: Collection[str] = ()) -> mujoco.MjSpec:
    """Reads a file, but none of what drives or watches its bodies, and only the named sites.

    The scene says how it is simulated and drawn; what the file says of that is forgotten, or MuJoCo would
    warn of each difference when it is attached.
    """
    spec = mujoco.MjSpec.from_file(str(resolve(reference)))
    visual, ours = spec.visual, scene.visual
    parts = ((visual.map, ours.map), (visual.quality, ours.quality), (visual.global_, ours.global_))
    for own, other in ((spec.option, scene.option), *parts):
        for name in dir(own):
            if not name.startswith("_") and not callable(getattr(own, name)):
                setattr(own, name, getattr(other, name))
    others = [site for site in spec.sites if site.name not in sites]
    for item in (*spec.cameras, *spec.lights, *spec.sensors, *spec.actuators, *spec.equalities, *others):
        spec.delete(item)
    return spec


def keep_only(spec: mujoco.MjSpec, body) -> None:
    """Deletes the file's other bodies, and meshes, materials and pictures that nothing uses any more.

    What is attached to a scene brings all of its file's, used or not.
    """
    kept = {body.name}
    while body.parent is not None:
        body = body.parent
        kept.add(body.name)
    for other in list(spec.worldbody.bodies):
        if other.name not in kept:
            spec.delete(other)
    geoms = list(spec.geoms)
    _delete_others(spec, spec.meshes, {geom.meshname for geom in geoms})
    _delete_others(spec, spec.materials, {geom.material for geom in geoms})
    pictures = {name for material in spec.materials for name in material.textures}
    _delete_others(spec, spec.textures, pictures)


def _delete_others(spec: mujoco.MjSpec, items: list, used: set[str]) -> None:
    for item in list(items):
        if item.name not in used:
            spec.delete(item)
