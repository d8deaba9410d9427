"""The lighting channel: a distant light, an array of cylinder lamps, reflectance of surfaces and objects.

:class:`envs.scenario.LightingCfg` has the ranges.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import override

import numpy as np

from envs.core.errors import ConfigError
from envs.randomization.channels import Channel, Scene
from envs.scenario import SURFACES, Appearance, LightCfg, LightingCfg, SurfaceMaterial, Vec3
from envs.scenario.lighting import TEMPERATURES_K


@dataclass(frozen=True, kw_only=True, slots=True)
class LightsDraw:
    """One sample of the lights.

    Attributes:
        azimuth_rad: Direction to the distant light, from world +x towards +y.
        polar_rad: Angle between that direction and straight up.
        distant_intensity: Its intensity.
        array_intensity: Intensity of all lamps together.
        radius_m: Radius of every lamp.
        length_m: Length of every lamp.
        temperature_k: Colour temperature of every light, K.
    """

    azimuth_rad: float
    polar_rad: float
    distant_intensity: float
    array_intensity: float
    radius_m: float
    length_m: float
    temperature_k: float


@dataclass(frozen=True, slots=True)
class Reflection:
    """Reflectance of a surface; each value is in [0, 1)."""

    roughness: float
    specular: float
    metallic: float


def draw_lights(rng: np.random.Generator, cfg: LightingCfg) -> LightsDraw:
    """Draws what the lights of one episode are like.

    Args:
        rng: The lighting channel's random numbers of one episode.
        cfg: Ranges.
    """
    return LightsDraw(
        azimuth_rad=float(rng.uniform(0.0, 2 * math.pi)),
        polar_rad=float(rng.uniform(*cfg.distant_polar_rad)),
        distant_intensity=float(rng.uniform(*cfg.distant_intensity)),
        array_intensity=float(rng.uniform(*cfg.array_intensity)),
        radius_m=float(rng.uniform(*cfg.radius_m)),
        length_m=float(rng.uniform(*cfg.length_m)),
        temperature_k=float(rng.uniform(*cfg.temperature_k)),
    )


def build_lights(draw: LightsDraw, cfg: LightingCfg) -> tuple[LightCfg, ...]:
    """Returns the distant light and, after it, the lamps: all alike, and all of its colour."""
    color = temperature_to_rgb(draw.temperature_k)
    # Rounded, so that every machine's libm gives the same numbers.
    x = round(math.sin(draw.polar_rad) * math.cos(draw.azimuth_rad), 9)
    y = round(math.sin(draw.polar_rad) * math.sin(draw.azimuth_rad), 9)
    z = round(math.cos(draw.polar_rad), 9)
    distant = LightCfg(
        kind="distant",
        pos=(4.0 * x, 4.0 * y, 4.0 * z),
        direction=(-x, -y, -z),
        color=color,
        intensity=draw.distant_intensity,
        cast_shadow=cfg.cast_shadow,
    )
    num_x, num_y = cfg.array_shape
    lamps = [
        LightCfg(
            kind="area",
            pos=(
                (i - (num_x - 1) / 2) * cfg.array_spacing_m,
                (j - (num_y - 1) / 2) * cfg.array_spacing_m,
                cfg.array_height_m,
            ),
            color=color,
            intensity=draw.array_intensity / (num_x * num_y),
            radius_m=draw.radius_m,
            length_m=draw.length_m,
        )
        for i in range(num_x)
        for j in range(num_y)
    ]
    return (distant, *lamps)


def draw_reflection(rng: np.random.Generator) -> Reflection:
    """Draws roughness, specular strength and metallic share, each U(0, 1)."""
    roughness, specular, metallic = rng.uniform(0.0, 1.0, 3)
    return Reflection(float(roughness), float(specular), float(metallic))


def planckian_xy(temperature_k: float) -> tuple[float, float]:
    """Returns the CIE 1931 chromaticity of a black body.

    Cubic approximation of the Planckian locus by B. Kang et al., "Design of advanced color temperature
    control system for HDTV applications", J. Korean Phys. Soc. 41 (2002) 865-871; 1667 K to 25000 K.

    Raises:
        ConfigError: if the temperature is out of that range.
    """
    t = float(temperature_k)
    coldest, hottest = TEMPERATURES_K
    if not coldest <= t <= hottest:
        raise ConfigError(f"A colour temperature is {coldest:g} to {hottest:g} K, given {temperature_k}.")
    k = 1000.0 / t
    if t <= 4000.0:
        x = ((-0.2661239 * k - 0.2343589) * k + 0.8776956) * k + 0.179910
    else:
        x = ((-3.0258469 * k + 2.1070379) * k + 0.2226347) * k + 0.240390
    if t <= 2222.0:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif t <= 4000.0:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return x, y


def temperature_to_rgb(temperature_k: float) -> Vec3:
    """Returns the linear sRGB colour of a black body, its largest component scaled to 1.

    The matrix is that of IEC 61966-2-1 (D65); a component outside the gamut becomes 0.

    Raises:
        ConfigError: if the temperature is outside 1667 to 25000 K.
    """
    x, y = planckian_xy(temperature_k)
    X, Z = x / y, (1.0 - x - y) / y
    rgb = (
        3.2406255 * X - 1.5372080 - 0.4986286 * Z,
        -0.9689307 * X + 1.8757561 + 0.0415175 * Z,
        0.0557101 * X - 0.2040211 + 1.0569959 * Z,
    )
    largest = max(rgb)
    red, green, blue = (max(component, 0.0) / largest for component in rgb)
    return red, green, blue


@dataclass(frozen=True, slots=True)
class LightingDraw:
    """One sample of the lighting channel.

    Attributes:
        lights: The scene's lights.
        reflection: Surface, or ``"objects"``, to how it reflects.
    """

    lights: LightsDraw
    reflection: Mapping[str, Reflection]


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
