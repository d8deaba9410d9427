"""Colours and texture images of the geoms of a compiled model, for renderers that need them."""

import mujoco
import numpy as np

from envs.scenario import SURFACES

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""A geom of this colour takes its material's (MuJoCo, ``engine_vis_visualize.c``, ``setMaterial``)."""


def rgba_of(model: mujoco.MjModel, geoms: np.ndarray) -> np.ndarray:
    """Returns the colours of geoms (n,), in copies (n, 4), by MuJoCo's rule."""
    own, material = model.geom_rgba[geoms], model.geom_matid[geoms]
    bare = (material >= 0) & np.isclose(own, _DEFAULT_RGBA).all(axis=1)
    if bare.any():
        own[bare] = model.mat_rgba[material[bare]]
    return own


def surfaces_of(model: mujoco.MjModel) -> dict[int, str]:
    """Returns the geoms of the table, the walls and the ground, and which of them each is."""
    materials = {model.material(surface).id: surface for surface in SURFACES}
    owners = enumerate(model.geom_matid.tolist())
    return {geom: materials[material] for geom, material in owners if material in materials}


def texture_id(model: mujoco.MjModel, geom: int) -> int:
    """Returns the texture of a geom's colour, or -1."""
    material = int(model.geom_matid[geom])
    return int(model.mat_texid[material, _RGB]) if material >= 0 else -1


def image_of(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """Returns the image of a texture, (H, W, 3) uint8; a grey one has equal channels."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    channels, first = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
    pixels = model.tex_data[first : first + height * width * channels].reshape(height, width, channels)
    return np.repeat(pixels, 3, axis=-1) if channels == 1 else pixels[..., :3].copy()
