"""Simulators and renderers, by name; each is imported when it is first used."""

from typing import TYPE_CHECKING

from envs.core.registry import Registry

if TYPE_CHECKING:
    from envs.simulators.base import Handler
    from envs.simulators.mujoco.render import Renderer

HANDLERS: "Registry[type[Handler]]" = Registry("simulator")
HANDLERS.add(
    "mujoco",
    "envs.simulators.mujoco.handler:MujocoHandler",
    summary="MuJoCo 4 on CPU, environments stepped by native threads (default)",
)
HANDLERS.add(
    "mujoco_warp",
    "envs.simulators.mujoco_warp.handler:MujocoWarpHandler",
    summary="MuJoCo Warp: all environments on one GPU (also on CPU, slowly)",
    info={"cannot": "states are float32; a CPU steps it slowly"},
)

HANDLERS.add(
    "sapien",
    "envs.simulators.sapien.handler:SapienHandler",
    extra="sapien",
    summary="SAPIEN 3: PhysX on CPU, environments stepped by threads; its own Vulkan renderer",
    info={
        "cannot": "no welds, tendons, coupled or ball joints; at most 32 sets of bodies excluded from "
        "contact; friction of two things is the mean of theirs; float32"
    },
)
HANDLERS.add(
    "newton",
    "envs.simulators.newton.handler:NewtonHandler",
    extra="newton",
    summary="Newton 1.8: its MuJoCo solver on CPU, one model for each environment",
    info={"cannot": "no welds, tendons, coupled or ball joints; up to about 250 shapes; float32"},
)

HANDLERS.add(
    "pybullet",
    "envs.simulators.pybullet.handler:PybulletHandler",
    extra="pybullet",
    summary="Bullet by PyBullet on CPU, one client per environment; its own software rasterizer",
    info={
        "cannot": "no welds, tendons, coupled or ball joints, nor torques; friction of two things is the "
        "product of theirs; hulls are 1 mm thicker; float32"
    },
)

HANDLERS.add(
    "genesis",
    "envs.simulators.genesis.handler:GenesisHandler",
    extra="genesis",
    summary="Genesis 1.4 on CPU: all environments are one batch; its first use compiles for minutes",
    info={
        "cannot": "no welds, tendons, coupled or ball joints, nor torques; friction is at least 0.01; float32"
    },
)

RENDERERS: "Registry[type[Renderer]]" = Registry("renderer")
RENDERERS.add(
    "warp",
    "envs.simulators.mujoco.render_warp:WarpRenderer",
    summary="batch ray tracer of mujoco_warp, needs no system package (default)",
    info={"cannot": "metallic, lamp_shape"},
)
RENDERERS.add(
    "gl",
    "envs.simulators.mujoco.render_gl:GlRenderer",
    summary="MuJoCo's OpenGL rasterizer; needs libegl1 and libgl1, or libosmesa6",
    info={"cannot": "metallic, lamp_shape"},
)
RENDERERS.add(
    "filament",
    "envs.simulators.mujoco.render_filament:FilamentRenderer",
    summary="physically based rendering by Filament; needs a Vulkan driver",
    info={"cannot": "lamp_shape"},
)
RENDERERS.add(
    "sapien",
    "envs.simulators.sapien.render:SapienRenderer",
    extra="sapien",
    summary="SAPIEN's physically based rasterizer; needs a Vulkan driver (Mesa 25 where there is no GPU)",
    info={"cannot": "lamp_shape"},
)
RENDERERS.add(
    "pybullet",
    "envs.simulators.pybullet.render:TinyRenderer",
    extra="pybullet",
    summary="PyBullet's software rasterizer: one light, no reflections; needs no driver",
    info={"cannot": "roughness, specular, metallic, object_reflection, lamp_shape, lamp_direction"},
)
RENDERERS.add(
    "newton",
    "envs.simulators.newton.render:NewtonRenderer",
    extra="newton",
    summary="Newton's ray tracer on CPU: every light and its shadows, no reflections; needs no driver",
    info={"cannot": "roughness, specular, metallic, object_reflection, lamp_shape, lamp_direction"},
)
