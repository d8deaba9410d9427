"""Images of MuJoCo models by Newton's ray tracer, on the CPU: every light, and textures, but no highlights.

Newton shades in linear light and takes sRGB colours; here colours are linear, as in the other renderers. So
colours and images are encoded as sRGB for Newton, and its image before the conversion to sRGB is returned.
Its public call lights a scene with one distant light; its kernel takes any number, which are written to the
sensor's own arrays, as are the textures of surfaces.
"""

from collections.abc import Sequence
from typing import Any, override

import mujoco
import newton
import numpy as np
import warp as wp
from newton.sensors import SensorCamera

from envs.core.errors import SimulatorError
from envs.mjcf.geom_colors import image_of, rgba_of, surfaces_of, texture_id
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.objects import SCENE_GROUP
from envs.rotations import from_matrix
from envs.scenario import SURFACES, Appearance, LightCfg
from envs.simulators.mujoco.render import AMBIENT_FRACTION, texture_of
from envs.simulators.mujoco.render_one_by_one import StagedRenderer
from envs.simulators.newton.shapes import view
from envs.simulators.newton.surfaces import SurfaceImages, brightened
from envs.simulators.pybullet.meshes import triangles_of
from envs.start_warp import start_warp

BACKGROUND = (0.6, 0.65, 0.7)

NOTHING = 0xFFFFFFFF
"""Newton's index of no shape."""

DISTANT, POINT = 1, 2
"""Kinds of light in Newton's kernel, where 0 is a spot; whatever is neither shines to all sides."""

FADING_PER_M2 = 0.02
"""A lamp of Newton fades by 1 / (1 + FADING_PER_M2 · d²)."""

_GEOM = mujoco.mjtGeom


class NewtonRenderer(StagedRenderer):
    """A Newton model of the visible geoms, without joints, with poses and appearance set job by job."""

    not_shown = ("roughness", "specular", "metallic", "object_reflection", "lamp_shape", "lamp_direction")

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        start_warp()
        self._surface_of = surfaces_of(model)
        self._geoms = _shown(model)
        self._slots = np.flatnonzero(np.isin(self._geoms, self._stage.furniture.geoms))
        self._newton = self._build()
        self._state = self._newton.state()
        self._sensor: Any = SensorCamera(self._newton)
        self._images = SurfaceImages(self._sensor, [self._surface_of.get(int(geom)) for geom in self._geoms])
        self._config = SensorCamera.RenderConfig(enable_textures=True, enable_shadows=True)
        self._rays: dict[str, Any] = {}
        self._table_z = 0.0 if scenario.table is None else scenario.table.pos[2]
        self._closed = False

    def _build(self) -> newton.Model:
        builder = newton.ModelBuilder(gravity=wp.vec3(0.0, 0.0, 0.0))
        cfg = newton.ModelBuilder.ShapeConfig(
            density=0.0, has_shape_collision=False, has_particle_collision=False
        )
        meshes: dict[int, newton.Mesh] = {}
        for geom in self._geoms.tolist():
            self._add(builder, geom, cfg, meshes)
        return builder.finalize(device="cpu")

    def _add(self, builder: newton.ModelBuilder, geom: int, cfg, meshes: dict[int, newton.Mesh]) -> None:
        model = self._stage.model
        kind, size = int(model.geom_type[geom]), [float(value) for value in model.geom_size[geom]]
        if kind == _GEOM.mjGEOM_SPHERE:
            builder.add_shape_sphere(-1, radius=size[0], cfg=cfg)
        elif kind == _GEOM.mjGEOM_CAPSULE:
            builder.add_shape_capsule(-1, radius=size[0], half_height=size[1], cfg=cfg)
        elif kind == _GEOM.mjGEOM_CYLINDER:
            builder.add_shape_cylinder(-1, radius=size[0], half_height=size[1], cfg=cfg)
        elif kind == _GEOM.mjGEOM_ELLIPSOID:
            builder.add_shape_ellipsoid(-1, rx=size[0], ry=size[1], rz=size[2], cfg=cfg)
        elif kind == _GEOM.mjGEOM_BOX and geom not in self._surface_of:
            builder.add_shape_box(-1, hx=size[0], hy=size[1], hz=size[2], cfg=cfg)
        else:
            key = int(model.geom_dataid[geom]) if kind == _GEOM.mjGEOM_MESH else -1 - geom
            if key not in meshes:
                meshes[key] = self._mesh(geom)
            builder.add_shape_mesh(-1, mesh=meshes[key], cfg=cfg)

    def _mesh(self, geom: int) -> newton.Mesh:
        triangles = triangles_of(self._stage.model, geom)
        return newton.Mesh(
            np.asarray(triangles.vertices, np.float32),
            np.asarray(triangles.faces, np.int32).ravel(),
            normals=np.asarray(triangles.normals, np.float32),
            uvs=np.asarray(triangles.uvs, np.float32),
            compute_inertia=False,
            texture=self._own_texture(geom),
        )

    def _own_texture(self, geom: int) -> np.ndarray | None:
        """The image of an object's mesh, (H, W, 3) uint8."""
        texture = texture_id(self._stage.model, geom)
        if texture < 0 or geom in self._surface_of:
            return None
        image = image_of(self._stage.model, texture) / 255.0
        return np.rint(255.0 * brightened(image)).astype(np.uint8)

    @override
    def dress(self, appearance: Appearance) -> None:
        stage = self._stage
        model, base = stage.model, self.scenario.appearance
        view(self._newton.shape_color)[:] = brightened(rgba_of(model, self._geoms)[:, :3])
        scale = view(self._newton.shape_scale)
        for shape in self._slots.tolist():
            geom = int(self._geoms[shape])
            scale[shape] = _scale(int(model.geom_type[geom]), model.geom_size[geom])
        for surface in SURFACES:
            name = stage.surface_textures[surface]
            look = appearance.materials.get(surface) or base.materials.get(surface)
            metres = 1.0 if look is None else look.size_m
            self._images.show(surface, name, metres, lambda n=name: texture_of(n, self.textures))
        self._images.upload()
        self._shine(appearance.lights or base.lights or (LightCfg(cast_shadow=True),))

    def _shine(self, lights: Sequence[LightCfg]) -> None:
        kinds, places, ways, colours = [], [], [], []
        for light in lights:
            way = np.asarray(light.direction, np.float64)
            colour = light.intensity * np.asarray(light.color, np.float64)
            distant = light.kind == "distant"
            if not distant:  # as bright as it says at the height of the table
                colour = colour * (1.0 + FADING_PER_M2 * (light.pos[2] - self._table_z) ** 2)
            kinds.append(DISTANT if distant else POINT)
            places.append((0.0, 0.0, 0.0) if distant else light.pos)
            ways.append(way / np.linalg.norm(way))
            colours.append(colour)
        context = self._sensor._render_context
        context._lights_active = wp.array([True] * len(lights), dtype=wp.bool, device="cpu")
        context._lights_type = wp.array(kinds, dtype=wp.int32, device="cpu")
        shadows = [light.cast_shadow for light in lights]
        context._lights_cast_shadow = wp.array(shadows, dtype=wp.bool, device="cpu")
        context._lights_position = wp.array(np.array(places, np.float32), dtype=wp.vec3f, device="cpu")
        context._lights_orientation = wp.array(np.array(ways, np.float32), dtype=wp.vec3f, device="cpu")
        context._lights_color = wp.array(np.array(colours, np.float32), dtype=wp.vec3f, device="cpu")
        total = sum((light.intensity * np.asarray(light.color) for light in lights), start=np.zeros(3))
        self._sensor.set_ambient_light((AMBIENT_FRACTION * total).tolist())

    @override
    def pose(self, cameras: tuple[str, ...]) -> None:
        data = self._stage.data
        poses = view(self._newton.shape_transform)
        poses[:, :3] = data.geom_xpos[self._geoms]
        turns = from_matrix(data.geom_xmat[self._geoms].reshape(-1, 3, 3))
        poses[:, 3:] = turns[:, [1, 2, 3, 0]]
        self._newton.bvh_refit_shapes(self._state)

    @override
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        stage = self._stage
        index_of = stage.model.camera(camera).id
        width, height = (int(size) for size in stage.model.cam_resolution[index_of])
        if camera not in self._rays:
            fov = float(np.radians(stage.model.cam_fovy[index_of]))
            self._rays[camera] = SensorCamera.compute_camera_rays_pinhole(
                width, height, camera_fov=fov, device="cpu"
            )
        quat = from_matrix(stage.data.cam_xmat[index_of].reshape(3, 3))[[1, 2, 3, 0]]
        pose = np.concatenate([stage.data.cam_xpos[index_of], quat]).astype(np.float32)
        sensor = self._sensor
        wanted = {"shape_index_image": sensor.allocate_image_shape_index(1, width, height)}
        if "rgb" in out:
            wanted["hdr_color_image"] = sensor.allocate_image_color_hdr(1, width, height)
        if "depth" in out:
            wanted["forward_depth_image"] = sensor.allocate_image_depth_forward(1, width, height)
        sensor.update(
            self._state,
            wp.array(pose[None], dtype=wp.transformf, device="cpu"),
            self._rays[camera],
            render_config=self._config,
            **wanted,
        )
        drawn = {key: image.numpy()[0] for key, image in wanted.items()}
        shapes = drawn["shape_index_image"]
        nothing = shapes == NOTHING
        if "rgb" in out:
            light = np.clip(drawn["hdr_color_image"], 0.0, 1.0)
            out["rgb"][index] = np.rint(255.0 * np.where(nothing[..., None], np.array(BACKGROUND), light))
        if "depth" in out:
            out["depth"][index] = np.where(nothing, 0.0, drawn["forward_depth_image"])
        if "segmentation" in out:
            geoms = np.append(self._geoms, -1)
            out["segmentation"][index] = self.segment(geoms[np.where(nothing, len(self._geoms), shapes)])

    @override
    def close(self) -> None:
        if not self._closed:
            self._images.close()
            del self._sensor, self._state, self._newton
            self._rays = {}
            self._closed = True


def _shown(model: mujoco.MjModel) -> np.ndarray:
    """Returns the ids of the visible geoms, (n,)."""
    everyone = np.arange(model.ngeom)
    drawn = np.isin(model.geom_group, (VISUAL_GROUP, SCENE_GROUP)) & (rgba_of(model, everyone)[:, 3] > 0.0)
    kinds = [_GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF]
    odd = np.flatnonzero(drawn & np.isin(model.geom_type, [int(kind) for kind in kinds]))
    if len(odd):
        name = model.geom(int(odd[0])).name or f"number {odd[0]}"
        raise SimulatorError(
            f"renderer=newton cannot render the geom '{name}' ({_GEOM(int(model.geom_type[odd[0]])).name}). "
            "Take renderer=warp."
        )
    return everyone[drawn]


def _scale(kind: int, size: np.ndarray) -> tuple[float, float, float]:
    """Returns Newton's three numbers for the size of a primitive."""
    x, y, z = (float(value) for value in size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return x, 0.0, 0.0
    if kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
        return x, y, 0.0
    return x, y, z
