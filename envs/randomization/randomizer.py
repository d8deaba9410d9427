"""Maps an episode's index to the appearance of its scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from envs.core.errors import ConfigError, unknown_name
from envs.randomization.cameras import place_camera
from envs.randomization.furniture import Placement, draw_furniture, furnish
from envs.randomization.levels import CHANNELS
from envs.randomization.lights import (
    LightsDraw,
    Reflection,
    build_lights,
    draw_lights,
    draw_reflection,
)
from envs.randomization.materials import MaterialLibrary
from envs.randomization.seeding import channel_rng
from envs.randomization.splits import Split, load_split
from envs.scenario import SURFACES, Appearance, CameraCfg, LightingCfg, ScenarioCfg, SurfaceMaterial


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


class Randomizer:
    """Samples the appearance of episodes: a pure function of the seed, the split and the episode's index.

    Args:
        base: Appearance at level 0; what no channel changes keeps it.
        cameras: The scenario's cameras; the camera channel moves each that is fixed in the world.
        channels: Channels that vary, of :data:`~envs.randomization.levels.CHANNELS`; see
            :func:`~envs.randomization.levels.channels_of`.
        split: ``"train"`` or ``"test"``, or a split that was loaded with the same library.
        seed: The protocol's seed.
        library: Materials; the procedural ones by default.
        lighting: Ranges of the lighting channel; by default those of ``scenario``.
        scenario: Whose room is furnished, with every camera that it may be seen through; without it the
            environment channel has no furniture.

    Raises:
        UnknownNameError: if a channel or the split does not exist.
    """

    def __init__(
        self,
        base: Appearance,
        cameras: Sequence[CameraCfg],
        *,
        channels: Sequence[str],
        split: str | Split,
        seed: int,
        library: MaterialLibrary | None = None,
        lighting: LightingCfg | None = None,
        scenario: ScenarioCfg | None = None,
    ) -> None:
        for channel in channels:
            if channel not in CHANNELS:
                raise unknown_name("channel", str(channel), CHANNELS)
        self.base = base
        self.cameras = tuple(cameras)
        self.channels = tuple(channel for channel in CHANNELS if channel in channels)
        self.library = library or MaterialLibrary.built_in()
        self.split = split if isinstance(split, Split) else load_split(split, library)
        self.seed = seed
        self.lighting = lighting or (scenario.lighting if scenario is not None else LightingCfg())
        self.scenario = scenario

    def appearance(self, episode: int) -> Appearance:
        """Returns how the scene looks in an episode; at level 0 exactly the base.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        self._check(episode)
        appearance = self.base
        if "environment" in self.channels:
            draw = self._environment(episode)
            appearance = _cover(appearance, draw)
            if self.scenario is not None:
                appearance = replace(appearance, furniture=furnish(self.scenario, draw.furniture))
        if "camera" in self.channels:
            poses = self._camera(episode)
            moved = {c.name: place_camera(c, poses[c.name]) for c in self.cameras if c.name in poses}
            appearance = replace(appearance, cameras={**appearance.cameras, **moved})
        if "lighting" in self.channels:
            appearance = _light(appearance, self._lighting(episode), self.lighting)
        return appearance

    def draws(self, episode: int) -> dict[str, Any]:
        """Returns the sampled values of an episode by channel, as plain JSON values.

        Raises:
            ConfigError: if the episode is not of this randomizer's split.
        """
        self._check(episode)
        draws: dict[str, Any] = {}
        if "environment" in self.channels:
            draws["environment"] = drawn = asdict(self._environment(episode))
            drawn["furniture"] = list(drawn["furniture"])
        if "camera" in self.channels:
            draws["camera"] = self._camera(episode)
        if "lighting" in self.channels:
            draws["lighting"] = asdict(self._lighting(episode))
        return draws

    def _check(self, episode: int) -> None:
        if episode not in self.split:
            valid = self.split.episodes
            raise ConfigError(
                f"Episode {episode} is not in the split '{self.split.name}' ({self.split.version}), which "
                f"has {len(valid)} episodes, {valid[0]} to {valid[-1]}. Take one of them, or name the other "
                f"split."
            )

    def _environment(self, episode: int) -> EnvironmentDraw:
        rng = channel_rng(self.seed, "environment", episode)
        textures, sizes = {}, {}
        for surface in SURFACES:
            names = self.split.materials[surface]
            textures[surface] = names[int(rng.integers(len(names)))]
            sizes[surface] = float(rng.uniform(*self.library.size_range_m(textures[surface], surface)))
        yaw = float(rng.uniform(0.0, 2 * math.pi))
        if self.scenario is None or self.scenario.room is None:
            return EnvironmentDraw(textures, sizes, yaw)
        own = channel_rng(self.seed, "environment/furniture", episode)
        layout, furniture = draw_furniture(own, self.split.layouts, self.split.furniture)
        return EnvironmentDraw(textures, sizes, yaw, layout, furniture)

    def _camera(self, episode: int) -> dict[str, str]:
        rng = channel_rng(self.seed, "camera", episode)
        poses = self.split.cameras
        standing = [camera.name for camera in self.cameras if camera.mount is None]
        return {name: poses[int(rng.integers(len(poses)))] for name in standing}

    def _lighting(self, episode: int) -> LightingDraw:
        rng = channel_rng(self.seed, "lighting", episode)
        lights = draw_lights(rng, self.lighting)
        return LightingDraw(lights, {surface: draw_reflection(rng) for surface in (*SURFACES, "objects")})


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
