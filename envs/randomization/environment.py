"""The environment channel: materials of surfaces, the table's yaw, furniture."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import override

import numpy as np

from envs.randomization.channels import Channel, Scene
from envs.randomization.furniture import Placement, draw_furniture, furnish
from envs.randomization.splits import Split
from envs.scenario import SURFACES, Appearance, SurfaceMaterial


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
