"""Images by Filament, physically based: the only renderer here that shows metals and rough surfaces."""

import ctypes
import ctypes.util
import importlib
from collections.abc import Mapping
from typing import Any, override

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.scenario import SURFACES, Appearance, GeomCfg
from envs.simulators.mujoco.render import fixed_view, metres_of_reversed_depth, texture_of
from envs.simulators.mujoco.render_one_by_one import StagedRenderer

LUX_PER_INTENSITY = 60_000.0
"""Illuminance of a distant light of intensity 1: Filament's default exposure shows white as white."""

CANDELA_PER_INTENSITY = 600_000.0
"""Luminous intensity of a lamp of intensity 1, seen from about 3 m."""

_SCENE = "scene"


class FilamentRenderer(StagedRenderer):
    """One Vulkan context; materials follow an appearance, textures and furniture by a new scene."""

    not_shown = ("lamp_shape",)

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        _require_vulkan()
        # The studio module brings Filament's compiled materials; without it a context ends the process.
        importlib.import_module("mujoco.studio")
        from mujoco import mjrf
        from mujoco.rendering.filament import renderer as filament

        self._mjrf, self._filament = mjrf, filament
        config = mjrf.ContextConfig()
        config.graphics_api = mjrf.GraphicsApi.GRAPHICS_API_VULKAN
        self._context = mjrf.Context(config)
        self._option, self._camera = fixed_view()
        self._uploaded: dict[str, str | None] | None = None
        self._furnished: Mapping[str, tuple[GeomCfg, ...]] = {}
        self._drawn: Any = None
        self._buffers: dict[tuple[str, str], np.ndarray] = {}

    @override
    def pose(self, cameras: tuple[str, ...]) -> None:
        _, _, lights, geometry = self._drawn
        lights.update(self._stage.data)
        geometry.update(self._stage.data)

    @override
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        for modality, images in out.items():
            images[index] = self._drawing(camera, modality)

    @override
    def dress(self, appearance: Appearance) -> None:
        model = self._stage.model
        for slot in range(self._stage.light_slots):
            distant = model.light_type[slot] == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
            brightest = float(model.light_diffuse[slot].max())
            unit = LUX_PER_INTENSITY if distant else CANDELA_PER_INTENSITY
            model.light_intensity[slot] = brightest * unit if model.light_active[slot] else 0.0
            if brightest > 0:
                model.light_diffuse[slot] /= brightest
        furniture = self._stage.furnished
        if self._uploaded == self._stage.surface_textures and self._furnished == furniture:
            return
        for surface in SURFACES:
            texture = model.texture(surface)
            size = int(texture.height[0] * texture.width[0] * texture.nchannel[0])
            first = int(model.tex_adr[texture.id])
            pixels = texture_of(self._stage.surface_textures[surface], self.textures)
            model.tex_data[first : first + size] = pixels.ravel()
        self._uploaded, self._furnished = dict(self._stage.surface_textures), furniture
        self._build_scene()

    def _build_scene(self) -> None:
        # A context with two scenes of one model renders neither, and a renderer keeps the scenes it made.
        self._drawn = None
        self._buffers.clear()
        self._renderer = self._filament.Renderer(self._context)
        scene, model = self._renderer.scene(_SCENE), self._stage.model
        scene.configure_from_model(model)
        resources = self._mjrf.ModelResources(self._context, model)
        lights = self._mjrf.ModelLights(scene, resources)
        geometry = self._mjrf.ModelRenderables(scene, resources)
        geometry.set_options(self._option)
        self._drawn = (resources, scene, lights, geometry)

    def _drawing(self, camera: str, modality: str) -> np.ndarray:
        modes, formats = self._mjrf.DrawMode, self._mjrf.PixelFormat
        model = self._stage.model
        self._camera.fixedcamid = model.camera(camera).id
        view_camera = mujoco.mjv_camera2GLCamera(model, self._stage.data, self._camera)
        width, height = (int(v) for v in model.cam_resolution[self._camera.fixedcamid])
        mode, pixel_format, shape, dtype = {
            "rgb": (modes.DRAW_MODE_DEFAULT, formats.PIXEL_FORMAT_RGB8, (3,), np.uint8),
            "depth": (modes.DRAW_MODE_DEPTH, formats.PIXEL_FORMAT_R32F, (), np.float32),
            "segmentation": (modes.DRAW_MODE_SEGMENTATION_BY_ID, formats.PIXEL_FORMAT_RGBA8, (4,), np.uint8),
        }[modality]
        target = f"{camera}/{modality}"
        if (camera, modality) not in self._buffers:
            self._buffers[camera, modality] = np.empty((height, width, *shape), dtype)
            self._renderer.target(target, self._buffers[camera, modality], pixel_format)
        buffer = self._buffers[camera, modality]
        plain = modality != "rgb"
        view = self._filament.View(
            scene=_SCENE,
            target=target,
            camera=view_camera,
            draw_mode=mode,
            post_processing=not plain,
            shadows=not plain,
        )
        self._renderer.render([view])
        if modality == "depth":
            return metres_of_reversed_depth(buffer, view_camera.frustum_near, view_camera.frustum_far)
        if modality == "segmentation":
            ids = buffer[..., :3].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32) - 1
            return self.segment(np.where(ids < self.model.ngeom, ids, -1))
        return buffer

    @override
    def close(self) -> None:
        self._buffers.clear()


def _require_vulkan() -> None:
    """Filament ends the process where it finds no Vulkan device; say so before it does."""
    reason = "there is no libvulkan"
    library = ctypes.util.find_library("vulkan")
    if library is not None:
        if _count_devices(ctypes.CDLL(library)):
            return
        reason = "libvulkan finds no device"
    raise SimulatorError(
        f"renderer=filament needs a Vulkan driver, and {reason}. Install libvulkan1 and "
        "mesa-vulkan-drivers, or take renderer=warp, which needs no system package."
    )


class _InstanceCreateInfo(ctypes.Structure):
    """VkInstanceCreateInfo: no layers, no extensions."""

    _fields_ = (
        ("type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("num_layers", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("num_extensions", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


def _count_devices(vulkan: ctypes.CDLL) -> int:
    """Returns how many physical devices Vulkan lists; 0 where it cannot be queried."""
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    created = vulkan.vkCreateInstance(ctypes.byref(_InstanceCreateInfo(type=1)), None, ctypes.byref(instance))
    if created != 0:
        return 0
    listed = vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    vulkan.vkDestroyInstance(instance, None)
    return count.value if listed == 0 else 0
