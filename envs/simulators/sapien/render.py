"""Images of MuJoCo models by SAPIEN's rasterizer: physically based materials, through Vulkan.

A surface always has an image, because SAPIEN shows no texture on a material that had none at first, and is
rebuilt when the size of the image changes. SAPIEN's shaders multiply a light by albedo / π, and let a
lamp's fall with the square of the distance; lights are set so that one of intensity 1 that shines straight
on a white chalky surface lights it to 1, a lamp's at the height of the table. What SAPIEN brightens for the
screen is undone, so that its images are comparable to the others'.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, override

import mujoco
import numpy as np
import sapien
from sapien import Pose

from envs.core.errors import SimulatorError
from envs.mjcf.geom_colors import rgba_of
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.objects import SCENE_GROUP
from envs.rotations import multiply
from envs.scenario import SURFACES, Appearance, LightCfg, SurfaceMaterial
from envs.simulators.mujoco.render import AMBIENT_FRACTION, LAMP_CUTOFF_DEG, texture_of
from envs.simulators.mujoco.render_one_by_one import StagedRenderer
from envs.simulators.sapien.visuals import VisualFactory

NO_DEVICE = (
    "SAPIEN found no Vulkan device to render with. On Debian 12 install its driver with: apt install "
    "-t bookworm-backports mesa-vulkan-drivers (version 25; 22.3 is too old), or take renderer=warp."
)

NEAR_M, FAR_M = 0.01, 50.0

GAMMA = 2.2
"""SAPIEN's shaders write light to the power 1 / GAMMA."""

BACKGROUND = (0.6, 0.65, 0.7)

SHADOW_HALF_SIZE_M = 2.5
"""Half the side of the square that the distant light's shadow map covers."""

SHADOW_MAP_SIZE = 2048

SPOT_LIGHTS = 7
"""Lamps of a scene; unused ones are dark, since another number of lights recompiles the shaders."""

_CAMERA_AXES = np.array([0.5, -0.5, 0.5, 0.5])
"""SAPIEN's camera axes (x forward, y left, z up) in MuJoCo's (x right, y up, z backward), wxyz."""


@cache
def _keep_compiled() -> object:
    """Returns the cache of SAPIEN's shaders, whose compilation takes each renderer seconds."""
    return sapien.render.RenderSystem()


class SapienRenderer(StagedRenderer):
    """One scene of visuals without physics, with poses and appearance set job by job."""

    not_shown = ("lamp_shape",)

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        try:
            sapien.render.set_log_level("error")
            _keep_compiled()
            self._scene = sapien.Scene([sapien.render.RenderSystem()])
        except RuntimeError as error:
            raise SimulatorError(f"{NO_DEVICE} ({error})") from error
        self._lights = _Lights(self._scene)
        self._cameras: dict[str, Any] = {}
        self._factory = VisualFactory(self._stage.model)
        self._slots = frozenset(self._stage.furniture.geoms.tolist())
        self._visible = self._find_visible()
        self._entities: dict[tuple[int, int], sapien.Entity] = {}
        self._is_furnished = False
        self._sizes_m: dict[str, float] = dict.fromkeys(SURFACES, 1.0)
        for key in self._visible:
            self._build(key)
        self._images: dict[str, tuple] = {}
        self._closed = False

    def _build(self, key: tuple[int, int]) -> None:
        """Rebuilds the visuals of a body under one segmentation name."""
        if key in self._entities:
            self._scene.remove_entity(self._entities.pop(key))
        entity = sapien.Entity()
        component = sapien.render.RenderBodyComponent()
        size = self._sizes_m.get(self.segmentation_names[key[1]], 1.0) if key[1] >= 0 else 1.0
        for geom in self._visible[key]:
            if geom not in self._slots or geom in self._used_slots():
                component.attach(self._factory.make(geom, 1.0 / size, fresh=geom in self._slots))
        entity.add_component(component)
        self._scene.add_entity(entity)
        self._entities[key] = entity
        identities = {built.per_scene_id: segment for (_, segment), built in self._entities.items()}
        self._segment_of = np.full(max(identities) + 2, -1, np.int32)
        self._segment_of[list(identities)] = list(identities.values())

    def _used_slots(self) -> frozenset[int]:
        """Returns the slots for furniture that the present looks use."""
        now, empty = self._stage.model.geom_size, self.model.geom_size
        return frozenset(slot for slot in self._slots if not np.array_equal(now[slot], empty[slot]))

    def _find_visible(self) -> dict[tuple[int, int], list[int]]:
        """Returns the visible geoms by their body and segmentation name."""
        model, groups = self.model, (VISUAL_GROUP, SCENE_GROUP)
        out: dict[tuple[int, int], list[int]] = {}
        alphas = rgba_of(model, np.arange(model.ngeom))[:, 3]
        for geom in range(model.ngeom):
            if model.geom_group[geom] in groups and alphas[geom] > 0.0:
                key = (int(model.geom_bodyid[geom]), int(self._segmentation_of_geom[geom]))
                out.setdefault(key, []).append(geom)
        return out

    @override
    def pose(self, cameras: tuple[str, ...]) -> None:
        data = self._stage.data
        for (body, _), entity in self._entities.items():
            entity.pose = Pose(data.xpos[body], data.xquat[body])
        for name in cameras:
            self._place(name)
        self._scene.update_render()

    @override
    def dress(self, appearance: Appearance) -> None:
        base = self.scenario.appearance
        for surface in SURFACES:
            material = appearance.materials.get(surface) or base.materials.get(surface) or SurfaceMaterial()
            self._paint(surface, material)
        self._factory.reflect(appearance.object_reflection or self._stage.default_reflection)
        if self._stage.furnished or self._is_furnished:
            for key in [key for key, geoms in self._visible.items() if not self._slots.isdisjoint(geoms)]:
                self._build(key)
            self._is_furnished = bool(self._stage.furnished)
        table = 0.0 if self.scenario.table is None else self.scenario.table.pos[2]
        self._lights.set(appearance.lights or base.lights or (LightCfg(cast_shadow=True),), table)

    def _paint(self, surface: str, look: SurfaceMaterial) -> None:
        """Writes a surface's look; its image is multiplied by its colour, which SAPIEN leaves out."""
        material = self._factory.surfaces[surface]
        material.roughness, material.specular, material.metallic = (
            look.roughness,
            look.specular,
            look.metallic,
        )
        key = (look.texture, look.rgb)
        if self._images.get(surface) != key:
            plain = texture_of(look.texture, self.textures)
            image = np.full((*plain.shape[:2], 4), 255, np.uint8)
            image[..., :3] = np.rint(plain * np.clip(look.rgb, 0.0, 1.0))
            texture = sapien.render.RenderTexture2D(image, "R8G8B8A8Unorm", srgb=False)
            material.set_base_color_texture(texture)
            self._images[surface] = key
        if look.texture is not None and look.size_m != self._sizes_m[surface]:
            self._sizes_m[surface] = look.size_m
            segment = self.segmentation_names.index(surface)
            for key in [key for key in self._visible if key[1] == segment]:
                self._build(key)

    def _place(self, name: str) -> None:
        stage = self._stage
        index = stage.model.camera(name).id
        width, height = (int(size) for size in stage.model.cam_resolution[index])
        camera = self._cameras.get(name)
        if camera is None:
            camera = sapien.render.RenderCameraComponent(width, height)
            camera.near, camera.far = NEAR_M, FAR_M
            entity = sapien.Entity()
            entity.add_component(camera)
            self._scene.add_entity(entity)
            self._cameras[name] = camera
            camera.set_fovy(math.radians(float(stage.model.cam_fovy[index])), compute_x=True)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, stage.data.cam_xmat[index])
        camera.entity.pose = Pose(stage.data.cam_xpos[index], multiply(quat, _CAMERA_AXES))

    @override
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        sensor = self._cameras[camera]
        sensor.take_picture()
        position = sensor.get_picture("Position") if len(out) > 1 or "rgb" not in out else None
        if "rgb" in out:
            colour = sensor.get_picture("Color")
            light = np.clip(colour[..., :3], 0.0, 1.0) ** GAMMA
            nothing = colour[..., 3:] == 0.0
            shown = np.where(nothing, np.array(BACKGROUND, np.float32), light)
            out["rgb"][index] = np.rint(255.0 * shown)
        if position is not None and "depth" in out:
            depth = -position[..., 2]
            out["depth"][index] = np.where((position[..., 3] < 1.0) & (depth > 0.0), depth, 0.0)
        if "segmentation" in out:
            ids = sensor.get_picture("Segmentation")[..., 1]
            out["segmentation"][index] = self._segment_of[np.minimum(ids, len(self._segment_of) - 1)]

    @override
    def close(self) -> None:
        if not self._closed:
            self._cameras, self._entities = {}, {}
            self._scene.clear()
            self._closed = True


class _Lights:
    """A distant light that casts shadows, one that does not, and lamps; unused ones are dark."""

    def __init__(self, scene: sapien.Scene) -> None:
        self._scene = scene
        self._distant = [_directional(scene, shadow) for shadow in (True, False)]
        self._lamps = [_spot(scene) for _ in range(SPOT_LIGHTS)]

    def set(self, lights: Sequence[LightCfg], table_z: float) -> None:
        """Sets a light; a lamp has its nominal brightness where its axis meets the table's height."""
        shadowed, plain = (
            [light for light in lights if light.kind == "distant" and light.cast_shadow is shadow]
            for shadow in (True, False)
        )
        lamps = [light for light in lights if light.kind != "distant"]
        for light, wanted in zip(self._distant, (shadowed, plain), strict=True):
            self._shine(light, wanted[0] if wanted else None, 1.0)
        extra = [*shadowed[1:], *plain[1:]]
        while len(self._lamps) < len(lamps):
            self._lamps.append(_spot(self._scene))
        for slot, light in enumerate(self._lamps):
            lamp = lamps[slot] if slot < len(lamps) else None
            down = 1.0 if lamp is None else max(lamp.pos[2] - table_z, 0.1)
            if lamp is not None:
                direction = np.asarray(lamp.direction) / np.linalg.norm(lamp.direction)
                down /= max(-direction[2], 0.1)
            self._shine(light, lamp, down**2)
        if extra:
            raise SimulatorError(
                f"renderer=sapien shows one distant light that casts shadows and one that does not; "
                f"given {len(shadowed)} and {len(plain)}."
            )
        total = sum((light.intensity * np.asarray(light.color) for light in lights), start=np.zeros(3))
        self._scene.render_system.ambient_light = (AMBIENT_FRACTION * total).astype(np.float32)

    @staticmethod
    def _shine(light, cfg: LightCfg | None, gain: float) -> None:
        if cfg is None:
            light.color = np.zeros(3, np.float32)
            return
        light.color = (math.pi * gain * cfg.intensity * np.asarray(cfg.color)).astype(np.float32)
        direction = np.asarray(cfg.direction, np.float64)
        turn = sapien.math.shortest_rotation([1, 0, 0], (direction / np.linalg.norm(direction)).tolist())
        pos = (0.0, 0.0, 0.0) if cfg.kind == "distant" else cfg.pos
        light.entity.pose = Pose(list(pos), turn)


def _directional(scene: sapien.Scene, shadow: bool):
    light = sapien.render.RenderDirectionalLightComponent()
    light.shadow = shadow
    light.shadow_near, light.shadow_far = -5.0, 5.0
    light.shadow_half_size, light.shadow_map_size = SHADOW_HALF_SIZE_M, SHADOW_MAP_SIZE
    return _added(scene, light)


def _spot(scene: sapien.Scene):
    light = sapien.render.RenderSpotLightComponent()
    light.inner_fov, light.outer_fov = 0.0, 2.0 * math.radians(LAMP_CUTOFF_DEG)
    light.shadow = False
    return _added(scene, light)


def _added(scene: sapien.Scene, light):
    entity = sapien.Entity()
    entity.add_component(light)
    light.color = np.zeros(3, np.float32)
    scene.add_entity(entity)
    return light
