"""Images of MuJoCo models by PyBullet's TinyRenderer, a rasterizer in software that needs no driver.

It supports one distant light with global diffuse, ambient and specular strengths: the first distant light of
an appearance; every other light is added to the ambient light. Shadows keep 40 % of the colour whatever the
light, so they are paler than in other renderers.
"""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import override

import numpy as np
import pybullet
from PIL import Image

from envs.core.errors import SimulatorError
from envs.mjcf.furniture import FURNITURE
from envs.mjcf.geom_colors import image_of, rgba_of, surfaces_of, texture_id
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.objects import SCENE_GROUP
from envs.rotations import from_matrix
from envs.scenario import SURFACES, Appearance, LightCfg, SurfaceMaterial
from envs.simulators.mujoco.render import AMBIENT_FRACTION, texture_of
from envs.simulators.mujoco.render_one_by_one import StagedRenderer
from envs.simulators.pybullet.meshes import Triangles, triangles_of

NEAR_M, FAR_M = 0.02, 20.0

DIFFUSE_OF_A_LAMP = 0.6
"""Share of a lamp's intensity that a surface gets from above, on average, where it is one of several."""

LIGHT_DISTANCE_M = 4.0
"""Distance of the light's shadow camera."""

FINE, SMALL_PIXELS = 3, 128 * 128
"""A small image is rendered at three times the resolution: TinyRenderer leaves out triangles smaller than
a hundredth of a pixel."""

SHAPES_KEPT = 512
"""Bullet keeps the files of at most so many shapes."""

BACKGROUND = (153, 166, 178)


class TinyRenderer(StagedRenderer):
    """A physics client with visual shapes only, with poses and appearance set job by job."""

    not_shown = ("roughness", "specular", "metallic", "object_reflection", "lamp_shape", "lamp_direction")

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise SimulatorError("PyBullet has no further physics client: it holds 1,024.")
        self._folder = Path(tempfile.mkdtemp(prefix="roboverse-pybullet-"))
        self._loaded: dict[str, int] = {}
        self._count = 0
        self._bodies: dict[int, int] = {}
        self._looks: dict[int, tuple] = {}
        self._segments = np.full(1, -1, np.int32)
        self._surface = surfaces_of(model)
        furniture = self.segmentation_names.index(FURNITURE)
        self._slots = {geom for geom in range(model.ngeom) if self._segmentation_of_geom[geom] == furniture}

    @override
    def dress(self, appearance: Appearance) -> None:
        """Rebuilds the visuals that changed, and sets the light."""
        base, model = self.scenario.appearance, self._stage.model
        materials = {
            surface: appearance.materials.get(surface) or base.materials.get(surface) or SurfaceMaterial()
            for surface in SURFACES
        }
        changed = False
        colours = rgba_of(model, np.arange(model.ngeom)).tolist()
        for geom, rgba in enumerate(colours):
            look = self._look(geom, rgba, materials)
            if look != self._looks.get(geom):
                self._build(geom, look)
                changed = True
        if changed:
            self._segments = np.full(max(self._bodies.values()) + 2, -1, np.int32)
            for geom, unique in self._bodies.items():
                self._segments[unique] = self._segmentation_of_geom[geom]
        self._light = _one_light(appearance.lights or base.lights or (LightCfg(cast_shadow=True),))

    def _look(self, geom: int, rgba: Sequence[float], materials: dict[str, SurfaceMaterial]) -> tuple | None:
        """Returns what a geom's image depends on, except its pose; None for one that is not visible."""
        model = self._stage.model
        if int(model.geom_group[geom]) not in (VISUAL_GROUP, SCENE_GROUP) or rgba[3] <= 0.0:
            return None
        surface = self._surface.get(geom)
        if surface is not None:
            look = materials[surface]
            return (look.texture, look.size_m, *look.rgb, 1.0)
        if geom in self._slots:
            return (None, int(model.geom_type[geom]), *rgba, *model.geom_size[geom])
        return (None, 1.0, *rgba)

    def _build(self, geom: int, look: tuple | None) -> None:
        self._looks[geom] = look  # pyright: ignore[reportArgumentType]
        if geom in self._bodies:
            pybullet.removeBody(self._bodies.pop(geom), physicsClientId=self._client)
        if look is None:
            return
        triangles, surface = triangles_of(self._stage.model, geom), self._surface.get(geom)
        uvs, rgba = triangles.uvs, look[2:6]
        texture = self._own_texture(geom)
        if surface is not None:
            uvs = uvs / look[1]
            texture = None if look[0] is None else self._load(look[0], texture_of(look[0], self.textures))
        shape = self._shape(triangles, uvs, rgba)
        unique = pybullet.createMultiBody(0.0, -1, shape, physicsClientId=self._client)
        if texture is not None:
            pybullet.changeVisualShape(unique, -1, textureUniqueId=texture, physicsClientId=self._client)
        self._bodies[geom] = unique

    def _shape(self, triangles: Triangles, uvs: np.ndarray, rgba: tuple[float, ...]) -> int:
        """Loads a shape from a file: vertices that are handed over PyBullet never frees."""
        self._count += 1  # a name of its own, so that no other file is taken for it
        path = self._folder / f"{self._count}.obj"
        path.write_text(_obj(triangles, uvs), encoding="ascii")
        try:
            return pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(path),
                rgbaColor=list(rgba),
                specularColor=[0.0, 0.0, 0.0],
                physicsClientId=self._client,
            )
        finally:
            path.unlink()
            if self._count % SHAPES_KEPT == 0:
                self._forget_files()

    def _forget_files(self) -> None:
        """Frees what Bullet keeps of files that it loaded; worlds let it keep files again when they load."""
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._client)

    def _own_texture(self, geom: int) -> int | None:
        """The image of an object's mesh."""
        texture = texture_id(self._stage.model, geom)
        if texture < 0 or geom in self._surface:
            return None
        return self._load(f"own/{texture}", image_of(self._stage.model, texture))

    def _load(self, name: str, image: np.ndarray) -> int:
        if name not in self._loaded:
            path = self._folder / f"{len(self._loaded)}.png"
            Image.fromarray(np.ascontiguousarray(image)).save(path)
            self._loaded[name] = pybullet.loadTexture(str(path), physicsClientId=self._client)
            path.unlink()
        return self._loaded[name]

    @override
    def pose(self, cameras: tuple[str, ...]) -> None:
        data, client = self._stage.data, self._client
        places = data.geom_xpos.tolist()
        turns = from_matrix(data.geom_xmat.reshape(-1, 3, 3))[:, [1, 2, 3, 0]].tolist()
        for geom, unique in self._bodies.items():
            pybullet.resetBasePositionAndOrientation(
                unique, places[geom], turns[geom], physicsClientId=client
            )

    @override
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        stage = self._stage
        index_of = stage.model.camera(camera).id
        width, height = (int(size) for size in stage.model.cam_resolution[index_of])
        fine = FINE if width * height <= SMALL_PIXELS else 1
        eye, axes = stage.data.cam_xpos[index_of], stage.data.cam_xmat[index_of].reshape(3, 3)
        view = pybullet.computeViewMatrix(eye.tolist(), (eye - axes[:, 2]).tolist(), axes[:, 1].tolist())
        fovy_deg = float(stage.model.cam_fovy[index_of])
        rgb, depth, ids = self._take(fine * width, fine * height, view, fovy_deg)
        nothing = depth >= 1.0
        middle = (slice(fine // 2, None, fine),) * 2
        if "rgb" in out:
            colour = np.where(nothing[..., None], np.array(BACKGROUND, np.uint8), rgb[..., :3])
            if fine > 1:
                colour = colour.reshape(height, fine, width, fine, 3).mean(axis=(1, 3))
            out["rgb"][index] = np.rint(colour)
        if "depth" in out:
            near = depth[middle].astype(np.float64)
            metres = NEAR_M * FAR_M / (FAR_M - (FAR_M - NEAR_M) * near)
            out["depth"][index] = np.where(nothing[middle], 0.0, metres)
        if "segmentation" in out:
            out["segmentation"][index] = self._segments[np.maximum(ids[middle], -1)]

    def _take(
        self, width: int, height: int, view: Sequence[float], fovy_deg: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns colours (H, W, 4), the depth buffer (H, W) and Bullet's numbers of bodies (H, W)."""
        lens = list(pybullet.computeProjectionMatrixFOV(fovy_deg, width / height, NEAR_M, FAR_M))
        # TinyRenderer looks through the corner of a pixel; everyone else, through its middle.
        lens[8] += 1.0 / width
        lens[9] += 1.0 / height
        _, _, rgb, depth, ids = pybullet.getCameraImage(
            width,
            height,
            view,
            lens,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
            **self._light,
        )
        colour = np.asarray(rgb, np.uint8).reshape(height, width, 4)
        return colour, np.reshape(depth, (height, width)), np.reshape(ids, (height, width))

    @override
    def close(self) -> None:
        if self._client >= 0:
            self._forget_files()
            pybullet.disconnect(self._client)
            shutil.rmtree(self._folder, ignore_errors=True)
        self._client = -1


def _one_light(lights: Sequence[LightCfg]) -> dict:
    """Returns TinyRenderer's arguments: the first distant light, and all else as ambient light."""
    strength = [light.intensity * np.asarray(light.color, np.float64) for light in lights]
    distant = [index for index, light in enumerate(lights) if light.kind == "distant"]
    main = distant[0] if distant else 0
    ambient = AMBIENT_FRACTION * np.sum(strength, axis=0)
    for index, light in enumerate(strength):
        if index != main:
            ambient += DIFFUSE_OF_A_LAMP * light
    total = strength[main] + ambient
    direction = -np.asarray(lights[main].direction, np.float64)
    share = float(strength[main].sum() / max(total.sum(), 1e-9))
    return {
        "lightDirection": (direction / np.linalg.norm(direction)).tolist(),
        "lightColor": total.tolist(),
        "lightDistance": LIGHT_DISTANCE_M,
        "lightAmbientCoeff": 1.0 - share,
        "lightDiffuseCoeff": share,
        "lightSpecularCoeff": 0.0,
        "shadow": int(lights[main].cast_shadow),
    }


def _obj(triangles: Triangles, uvs: np.ndarray) -> str:
    """Returns a Wavefront OBJ, with as many digits as a float has."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangles.vertices.tolist()]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in uvs.tolist()]
    lines += [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangles.normals.tolist()]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in (triangles.faces + 1).tolist()]
    return "\n".join(lines) + "\n"
