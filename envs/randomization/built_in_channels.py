"""The channels of the levels: environment, camera and lighting."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import override

import numpy as np

from envs.randomization.cameras import place_camera
from envs.randomization.channels import Channel, Scene
from envs.randomization.furniture import Placement, draw_furniture, furnish
from envs.randomization.lights import (
    LightsDraw,
    Reflection,
    build_lights,
    draw_lights,
    draw_reflection,
)
from envs.randomization.splits import Split
from envs.scenario import SURFACES, Appearance, LightingCfg, SurfaceMaterial


@dataclass(frozen=True, slots=True)
class EnvironmentDraw:
    """One sample of the environment channel.

    Attributes:
        textures: Surface to material.
        size_m: Surface to the side of the square that one copy of its texture covers.
        table_yaw_rad: Rotation of the table top.
        layout: Layout of the furniture, or None without a room.
        furniture: Piece and pose of each place.
    """

    textures: Mapping[str, str]
    size_m: Mapping[str, float]
    table_yaw_rad: float
    layout: str | None = None
    furniture: tuple[Placement, ...] = ()


@dataclass(frozen=True, slots=True)
class LightingDraw:
    """One sample of the lighting channel.

    Attributes:
        lights: The scene's lights.
        reflection: Surface, or ``"objects"``, to how it reflects.
    """

    lights: LightsDraw
    reflection: Mapping[str, Reflection]


class EnvironmentChannel(Channel):
    """Covers every surface with a material of the split and furnishes the room."""

    @override
    def split(self, scene: Scene) -> Split:
        return scene.split

    @override
    def sample(self, rng: np.random.Generator, allowed: Split, scene: Scene) -> EnvironmentDraw:
        textures, sizes = {}, {}
        for surface in SURFACES:
            names = allowed.materials[surface]
            textures[surface] = names[int(rng.integers(len(names)))]
            sizes[surface] = float(rng.uniform(*scene.library.size_range_m(textures[surface], surface)))
        yaw = float(rng.uniform(0.0, 2 * math.pi))
        if scene.scenario is None or scene.scenario.room is None:
            return EnvironmentDraw(textures, sizes, yaw)
        own = scene.rng("environment/furniture")
        layout, furniture = draw_furniture(own, allowed.layouts, allowed.furniture)
        return EnvironmentDraw(textures, sizes, yaw, layout, furniture)

    @override
    def apply(self, appearance: Appearance, draw: EnvironmentDraw, scene: Scene) -> Appearance:
        appearance = _cover(appearance, draw)
        if scene.scenario is not None:
            appearance = replace(appearance, furniture=furnish(scene.scenario, draw.furniture))
        return appearance


class CameraChannel(Channel):
    """Moves each camera that is fixed in the world to one of the split's poses."""

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return tuple(scene.split.cameras)

    @override
    def sample(self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene) -> dict[str, str]:
        standing = [camera.name for camera in scene.cameras if camera.mount is None]
        return {name: allowed[int(rng.integers(len(allowed)))] for name in standing}

    @override
    def apply(self, appearance: Appearance, draw: dict[str, str], scene: Scene) -> Appearance:
        moved = {c.name: place_camera(c, draw[c.name]) for c in scene.cameras if c.name in draw}
        return replace(appearance, cameras={**appearance.cameras, **moved})


class LightingChannel(Channel):
    """Draws the lamps, and how surfaces and objects reflect, from ranges that both splits share."""

    @override
    def split(self, scene: Scene) -> LightingCfg:
        return scene.lighting

    @override
    def sample(self, rng: np.random.Generator, allowed: LightingCfg, scene: Scene) -> LightingDraw:
        lights = draw_lights(rng, allowed)
        return LightingDraw(lights, {surface: draw_reflection(rng) for surface in (*SURFACES, "objects")})

    @override
    def apply(self, appearance: Appearance, draw: LightingDraw, scene: Scene) -> Appearance:
        return _light(appearance, draw, scene.lighting)


def _cover(appearance: Appearance, draw: EnvironmentDraw) -> Appearance:
    """Gives every surface its sampled material; its reflectance stays."""
    materials = dict(appearance.materials)
    for surface in SURFACES:
        materials[surface] = replace(
            materials.get(surface, SurfaceMaterial()),
            texture=draw.textures[surface],
            rgb=(1.0, 1.0, 1.0),
            size_m=draw.size_m[surface],
        )
    return replace(appearance, materials=materials, table_yaw_rad=draw.table_yaw_rad)


def _light(appearance: Appearance, draw: LightingDraw, cfg: LightingCfg) -> Appearance:
    """Replaces all lights and how everything reflects; what surfaces are made of stays."""
    materials = {
        surface: replace(
            appearance.materials.get(surface, SurfaceMaterial()), **asdict(draw.reflection[surface])
        )
        for surface in SURFACES
    }
    objects = draw.reflection["objects"]
    return replace(
        appearance,
        lights=build_lights(draw.lights, cfg),
        materials={**appearance.materials, **materials},
        object_reflection=(objects.roughness, objects.specular, objects.metallic),
    )
