"""Base of the renderers of MuJoCo models, which set poses and appearance job by job."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from envs.core.errors import ConfigError
from envs.mjcf.furniture import FURNITURE, FurnitureSlots
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.model import (
    OBJECT_MATERIAL,
    TABLE_BODY,
    TEXTURE_SIZE,
    camera_quat,
    light_slots,
)
from envs.mjcf.objects import SCENE_GROUP
from envs.rotations import from_yaw
from envs.scenario import SURFACES, Appearance, CameraCfg, GeomCfg, LightCfg, ScenarioCfg, SurfaceMaterial
from envs.simulators.base import TextureSource

AMBIENT_FRACTION = 0.3
"""Share of each light that reaches every surface, for the light that walls throw back."""

LAMP_CUTOFF_DEG = 85.0
"""Half angle of a ceiling lamp's cone."""

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


@dataclass(frozen=True, slots=True)
class RenderJob:
    """Snapshot of one environment: what its images depend on.

    Attributes:
        qpos: Joint positions, (nq,).
        mocap_pos: Positions of the bodies that are put in place, (nmocap, 3).
        mocap_quat: Their orientations, (nmocap, 4).
        appearance: How it looks.
    """

    qpos: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray
    appearance: Appearance


class Renderer(ABC):
    """Renders snapshots of one model.

    Args:
        model: The compiled scene; it is never written to.
        scenario: What it was compiled from.
        textures: ``textures(name, size)`` gives the image (size, size, 3) uint8 of a material.
        num_threads: Threads that may render at once; 0 means one per core.
    """

    not_shown: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        model: mujoco.MjModel,
        scenario: ScenarioCfg,
        *,
        textures: TextureSource | None = None,
        num_threads: int = 0,
    ) -> None:
        self.model = model
        self.scenario = scenario
        self.textures = textures
        self.num_threads = num_threads
        self.segmentation_names, self._segmentation_of_geom = segmentation_of_geoms(model, scenario)

    @abstractmethod
    def render(
        self, jobs: Sequence[RenderJob], cameras: tuple[str, ...], modalities: tuple[str, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        """Renders every job; returns what :meth:`envs.simulators.base.Handler.render` does."""

    @abstractmethod
    def close(self) -> None:
        """Frees the renderer's resources."""

    def segment(self, geom_ids: np.ndarray) -> np.ndarray:
        """Turns geom ids (…,), -1 for nothing, into indices of :attr:`segmentation_names`."""
        return self._segmentation_of_geom[geom_ids]

    def empty(
        self, num_jobs: int, cameras: tuple[str, ...], modalities: tuple[str, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        """Returns arrays to render into."""
        kinds = {"rgb": ((3,), np.uint8), "depth": ((), np.float32), "segmentation": ((), np.int32)}
        sizes = {camera.name: (camera.height, camera.width) for camera in self.scenario.cameras}
        return {
            name: {
                modality: np.empty((num_jobs, *sizes[name], *kinds[modality][0]), kinds[modality][1])
                for modality in modalities
            }
            for name in cameras
        }


class Stage:
    """A private copy of the model and its data, with poses and appearance set job by job.

    Attributes:
        model: The copy.
        data: Its data; positions of geoms, cameras and lights are current after :meth:`pose`.
        surface_textures: Surface to the name of its present texture, or None.
        furniture: Slots for the furniture of the room.
        furnished: Present furniture of the room.
        light_slots: Lights that a look may have.
    """

    def __init__(self, model: mujoco.MjModel, scenario: ScenarioCfg) -> None:
        self.model = copy.copy(model)
        self.data = mujoco.MjData(self.model)
        self._scenario = scenario
        self._materials = {surface: self.model.material(surface).id for surface in SURFACES}
        self._texture_ids = {surface: self.model.texture(surface).id for surface in SURFACES}
        self._looks = self.model.material(OBJECT_MATERIAL).id
        self.default_reflection = (0.6, 0.3, 0.0)
        self.light_slots = light_slots(scenario)
        self._table = self.model.body(TABLE_BODY).mocapid[0] if scenario.table is not None else -1
        self.furniture = FurnitureSlots(model)
        self.furnished: Mapping[str, tuple[GeomCfg, ...]] = {}
        self._extents = _surface_extents(scenario)
        self._dressed: Appearance | None = None
        self.surface_textures: dict[str, str | None] = dict.fromkeys(SURFACES)

    def pose(self, job: RenderJob) -> bool:
        """Puts the job on the stage; returns whether its appearance differs from the last one's."""
        changed = job.appearance is not self._dressed
        if changed:
            self.dress(job.appearance)
        data = self.data
        data.qpos[:] = job.qpos
        data.mocap_pos[:] = job.mocap_pos
        data.mocap_quat[:] = job.mocap_quat
        if self._table >= 0:
            data.mocap_quat[self._table] = from_yaw(job.appearance.table_yaw_rad)
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_camlight(self.model, data)
        return changed

    def dress(self, appearance: Appearance) -> None:
        """Writes an appearance to the model's materials, lights, cameras and furniture."""
        base = self._scenario.appearance
        for surface in SURFACES:
            material = appearance.materials.get(surface) or base.materials.get(surface) or SurfaceMaterial()
            self._set_surface(surface, material)
        self._set_reflection(self._looks, *(appearance.object_reflection or self.default_reflection))
        lights = appearance.lights or base.lights or (LightCfg(cast_shadow=True),)
        if len(lights) > self.light_slots:
            raise ConfigError(
                f"A look with {len(lights)} lights was given, and the scene was made for {self.light_slots}. "
                "Give its LightingCfg to the scenario."
            )
        for slot in range(self.light_slots):
            self._set_light(slot, lights[slot] if slot < len(lights) else None)
        for camera in self._scenario.cameras:
            self._set_camera(appearance.cameras.get(camera.name, camera))
        if appearance.furniture != self.furnished:
            self.furniture.furnish(self.model, appearance.furniture)
            self.furnished = appearance.furniture
        self._dressed = appearance

    def _set_surface(self, surface: str, material: SurfaceMaterial) -> None:
        index = self._materials[surface]
        self.model.mat_rgba[index, :3] = material.rgb
        width, height = self._extents[surface]
        self.model.mat_texrepeat[index] = (width / material.size_m, height / material.size_m)
        self.model.mat_texid[index, _RGB] = -1 if material.texture is None else self._texture_ids[surface]
        self._set_reflection(index, material.roughness, material.specular, material.metallic)
        self.surface_textures[surface] = material.texture

    def _set_reflection(self, index: int, roughness: float, specular: float, metallic: float) -> None:
        model = self.model
        model.mat_specular[index] = specular_strength(roughness, specular)
        model.mat_shininess[index] = shininess(roughness)
        model.mat_roughness[index] = roughness
        model.mat_metallic[index] = metallic

    def _set_light(self, slot: int, light: LightCfg | None) -> None:
        model = self.model
        model.light_active[slot] = light is not None
        if light is None:
            return
        distant = light.kind == "distant"
        kinds = mujoco.mjtLightType
        model.light_type[slot] = int(kinds.mjLIGHT_DIRECTIONAL if distant else kinds.mjLIGHT_SPOT)
        direction = np.asarray(light.direction, np.float64)
        colour = light.intensity * np.asarray(light.color)
        model.light_pos[slot] = light.pos
        model.light_dir[slot] = direction / np.linalg.norm(direction)
        model.light_diffuse[slot] = colour
        model.light_specular[slot] = colour
        model.light_ambient[slot] = AMBIENT_FRACTION * colour
        model.light_cutoff[slot] = LAMP_CUTOFF_DEG
        model.light_exponent[slot] = 1.0
        model.light_castshadow[slot] = light.cast_shadow

    def _set_camera(self, camera: CameraCfg) -> None:
        index = self.model.camera(camera.name).id
        self.model.cam_pos[index] = camera.pos
        self.model.cam_quat[index] = camera_quat(camera)


def fixed_view() -> tuple[mujoco.MjvOption, mujoco.MjvCamera]:
    """Returns what a visualizer shows, the visual geoms alone, and a camera of the model."""
    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    option.geomgroup[:] = 0
    option.geomgroup[[VISUAL_GROUP, SCENE_GROUP]] = 1
    option.sitegroup[:] = 0
    camera.type = int(mujoco.mjtCamera.mjCAMERA_FIXED)
    return option, camera


def texture_of(name: str | None, textures: TextureSource | None) -> np.ndarray:
    """Returns the image (S, S, 3) uint8 of a material; plain white for none."""
    if name is None or textures is None:
        return np.full((TEXTURE_SIZE, TEXTURE_SIZE, 3), 255, np.uint8)
    return textures(name, TEXTURE_SIZE)


def shininess(roughness: float) -> float:
    """Returns MuJoCo's shininess in [0, 1] for a roughness in [0, 1].

    The Blinn-Phong exponent of a microfacet roughness α = roughness² is 2/α² − 2 (Karis, "Specular
    BRDF Reference", 2013); MuJoCo's exponent is 128 times its shininess.
    """
    alpha = max(roughness, 0.05) ** 2
    return float(np.clip((2.0 / alpha**2 - 2.0) / 128.0, 0.0, 1.0))


def specular_strength(roughness: float, specular: float) -> float:
    """Returns MuJoCo's specular in [0, 1]: a rough surface spreads its highlight, and so dims it.

    The peak of the GGX lobe is F0 / (4 α²), with F0 = 0.08 · specular for a dielectric (Burley,
    "Physically Based Shading at Disney", 2012) and α = roughness².
    """
    alpha = max(roughness, 0.05) ** 2
    return float(min(1.0, 0.08 * specular / (4.0 * alpha**2)))


def metres_of_reversed_depth(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Turns a reversed depth buffer, 1 at the near plane and 0 at the far one, into metres; 0 is nothing."""
    metres = near * far / (near + depth.astype(np.float64) * (far - near))
    return np.where(depth > 0, metres, 0.0).astype(np.float32)


def _surface_extents(scenario: ScenarioCfg) -> dict[str, tuple[float, float]]:
    """Width and height, in metres, of what one unit of texture coordinates covers."""
    half = scenario.ground_half_size_m if scenario.room is None else scenario.room.half_size_m
    height = 4.0 if scenario.room is None else scenario.room.height_m
    table = (1.0, 1.0)
    if scenario.table is not None:
        table = (2 * scenario.table.half_size[0], 2 * scenario.table.half_size[1])
    return {"table": table, "wall": (2 * half, height), "ground": (2 * half, 2 * half)}


def segmentation_of_geoms(model: mujoco.MjModel, scenario: ScenarioCfg) -> tuple[tuple[str, ...], np.ndarray]:
    """Returns the names, and for each geom id its index among them; the last entry, for id -1, is -1."""
    names = (*(r.name for r in scenario.robots), *(o.name for o in scenario.objects), *SURFACES, FURNITURE)
    index = {name: position for position, name in enumerate(names)}
    of_geom = np.full(model.ngeom + 1, -1, np.int32)
    for geom in range(model.ngeom):
        own, body = model.geom(geom).name, model.body(int(model.geom_bodyid[geom])).name
        for candidate in (body.split("/")[0], own.split("_")[0], body.split("_")[0]):
            if candidate in index:
                of_geom[geom] = index[candidate]
                break
    return names, of_geom
