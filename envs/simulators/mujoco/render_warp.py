"""Images by mujoco_warp's ray tracer, on the CPU: no GPU, no display, no system package."""

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, override

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.core.machine import num_cores
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.model import TEXTURE_SIZE
from envs.mjcf.objects import HIDDEN_GROUP, SCENE_GROUP
from envs.scenario import SURFACES, Appearance
from envs.simulators.mujoco.mesh_bounds import MeshBounds
from envs.simulators.mujoco.render import Renderer, RenderJob, Stage, texture_of
from envs.simulators.mujoco.still_images import Images, StillImages
from envs.simulators.mujoco.tracer_parts import tracer_parts
from envs.simulators.mujoco.warp_launches import Launches
from envs.start_warp import start_warp

_LIGHT_FIELDS = (
    "light_type",
    "light_active",
    "light_castshadow",
    "light_diffuse",
    "light_specular",
    "light_ambient",
    "light_cutoff",
    "light_exponent",
)
_MATERIAL_FIELDS = ("mat_rgba", "mat_specular", "mat_shininess", "mat_texrepeat", "mat_texid")
_FURNITURE_FIELDS = ("geom_size", "geom_rgba")
_LOOKS = (*_LIGHT_FIELDS, *_MATERIAL_FIELDS, *_FURNITURE_FIELDS)
_COMPILING = Lock()

KEPT_TEXTURES = 32
"""Textures that a renderer keeps, 4 MiB each: those of ten environments, which it draws in turn."""

_FAR_M = 1e4
"""Where geoms are put that rays must not meet."""

_POSE_FIELDS = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir")


class WarpRenderer(Renderer):
    """One tracer per thread, each with its own stage; an image depends on its job alone."""

    not_shown = ("metallic", "lamp_shape")

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        self._size = num_threads or num_cores()
        self._pool = ThreadPoolExecutor(self._size, thread_name_prefix="render")
        self._idle: dict[tuple, SimpleQueue[_Tracer]] = {}
        self._textures_of_names: dict[str | None, Any] = {}
        self._uploading = Lock()

    @override
    def render(
        self, jobs: Sequence[RenderJob], cameras: tuple[str, ...], modalities: tuple[str, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        wp = start_warp()
        out = self.empty(len(jobs), cameras, modalities)
        tracers = self._tracers(cameras, modalities, len(jobs))

        def draw(index: int) -> None:
            tracer = tracers.get()
            try:
                tracer.draw(jobs[index], out, index)
            finally:
                tracers.put(tracer)

        # Warp's default device belongs to the process, so it is set here and not in the threads.
        with wp.ScopedDevice("cpu"):
            if len(jobs) == 1:
                draw(0)
            else:
                list(self._pool.map(draw, range(len(jobs))))
        return out

    def _tracers(self, cameras, modalities, num_jobs: int) -> "SimpleQueue[_Tracer]":
        key = (cameras, modalities)
        queue = self._idle.setdefault(key, SimpleQueue())
        while queue.qsize() < min(self._size, max(num_jobs, 1)):
            queue.put(_Tracer(self, cameras, modalities))
        return queue

    def uploaded(self, name: str | None) -> Any:
        """Returns a material's texture on the device; those used last are kept, for all tracers."""
        import warp as wp

        with self._uploading:
            texture = self._textures_of_names.pop(name, None)
            if texture is None:
                pixels = np.ones((TEXTURE_SIZE, TEXTURE_SIZE, 4), np.float32)
                pixels[..., :3] = texture_of(name, self.textures) / np.float32(255)
                texture = wp.Texture2D(wp.array(pixels), filter_mode=wp.TextureFilterMode.LINEAR)
            self._textures_of_names[name] = texture  # the last of the order
            if len(self._textures_of_names) > KEPT_TEXTURES:
                del self._textures_of_names[next(iter(self._textures_of_names))]
        return texture

    @override
    def close(self) -> None:
        self._pool.shutdown()
        self._idle.clear()
        self._textures_of_names.clear()


class _Tracer:
    """A stage and the device arrays that mirror it."""

    def __init__(self, renderer: WarpRenderer, cameras: tuple[str, ...], modalities: tuple[str, ...]) -> None:
        self._wp, self._parts = _start_with_compiler(), tracer_parts()
        self._renderer, self._cameras, self._modalities = renderer, cameras, modalities
        self._stage = Stage(renderer.model, renderer.scenario)
        model = self._stage.model
        ready_for_tracing(model)
        with self._wp.ScopedDevice("cpu"), contextlib.redirect_stdout(io.StringIO()):
            self._model = self._parts.put_model(model)
            self._data = self._parts.put_data(model, self._stage.data, nworld=1)
        # The same memory: what is written here is what the kernels read.
        self._looks = {name: getattr(self._model, name).numpy() for name in _LOOKS}
        self._poses = {name: getattr(self._data, name).numpy() for name in _POSE_FIELDS}
        self._sizes = [_size_of(model, name) for name in cameras]
        self._rooms: dict[bool, _Room] = {}
        self._enter(furnished=False)

    def _enter(self, *, furnished: bool) -> None:
        """Takes the tree of a room with furniture, or of one without, where rays are a tenth faster."""
        if furnished not in self._rooms:
            # Kernels are compiled at the first launch, which must not happen in two threads at once.
            with _COMPILING, self._wp.ScopedDevice("cpu"), contextlib.redirect_stdout(io.StringIO()):
                self._rooms[furnished] = self._new_room(furnished)
        self._room = self._rooms[furnished]
        self._texture_names: dict[str, str | None] = dict.fromkeys(SURFACES)  # each has textures of its own

    def _new_room(self, furnished: bool) -> "_Room":
        model, slots = self._stage.model, self._stage.furniture.geoms
        groups = model.geom_group[slots].copy()
        if not furnished:
            model.geom_group[slots] = HIDDEN_GROUP
        # Depth for still images; an image that needs none is traced without.
        context = create_context(model, self._cameras, (*self._modalities, "depth"), num_worlds=1)
        model.geom_group[slots] = groups
        bounds = Launches(partial(self._parts.refit_bvh, self._model, self._data, context))
        with _compiled_without_nan():
            rays = Launches(partial(self._parts.render, self._model, self._data, context))
        still = StillImages(
            model,
            context.enabled_geom_ids.numpy(),
            [model.camera(name).id for name in self._cameras],
            self._rays_of(context),
            self._modalities,
        )
        return _Room(context, self._modalities, bounds, rays, MeshBounds(model, context), still)

    def _rays_of(self, context: Any) -> list[np.ndarray]:
        """Returns each camera's rays in its frame, (H, W, 3)."""
        ends = np.cumsum([width * height for width, height in self._sizes])[:-1]
        parts = np.split(context.ray.numpy().copy(), ends)
        return [part.reshape(h, w, 3) for part, (w, h) in zip(parts, self._sizes, strict=True)]

    def draw(self, job: RenderJob, out: dict, index: int) -> None:
        """Draws one job into row ``index`` of ``out``."""
        if self._stage.pose(job):
            furnished = bool(self._stage.furnished)
            if self._room is not self._rooms.get(furnished):
                self._enter(furnished=furnished)
            _copy(self._stage.model, self._looks)
            self._upload_textures()
        _copy(self._stage.data, self._poses)
        self._fetch(self._room.trace(self._stage.data, job.appearance), out, index)

    def _upload_textures(self) -> None:
        wp, registry = self._wp, self._room.context.textures_registry
        changed = [s for s in SURFACES if self._stage.surface_textures[s] != self._texture_names[s]]
        for surface in changed:
            name = self._stage.surface_textures[surface]
            registry[self._stage.model.texture(surface).id] = self._renderer.uploaded(name)
            self._texture_names[surface] = name
        if changed:
            self._room.rays.replace("textures", wp.array(registry, dtype=wp.Texture2D))

    def _fetch(self, images: Images, out: dict, index: int) -> None:
        start = 0
        for name, (width, height) in zip(self._cameras, self._sizes, strict=True):
            span, shape = slice(start, start + width * height), (height, width)
            if "rgb" in self._modalities:
                packed = images["rgb"][0, span].view(np.uint8).reshape(*shape, 4)
                out[name]["rgb"][index] = packed[..., 2::-1]
            if "depth" in self._modalities:
                out[name]["depth"][index] = images["depth"][0, span].reshape(shape)
            if "segmentation" in self._modalities:
                ids = images["segmentation"][0, span].reshape(*shape, 2)[..., 0]
                out[name]["segmentation"][index] = self._renderer.segment(ids)
            start += width * height


class _Room:
    """The tree of a scene's visible geometry and the launches that trace rays through it.

    Args:
        context: mujoco_warp's render context, with depth.
        modalities: What images are to have.
        bounds: The launches of its ``refit_bvh``.
        rays: The launches of its ``render``.
        meshes: Tighter bounds of its meshes.
        still: Images without what moves.
    """

    def __init__(
        self,
        context: Any,
        modalities: tuple[str, ...],
        bounds: Launches,
        rays: Launches,
        meshes: MeshBounds,
        still: StillImages,
    ) -> None:
        self.context, self._bounds, self.rays, self._meshes, self._still = (
            context,
            bounds,
            rays,
            meshes,
            still,
        )
        self._has_depth = "depth" in modalities
        self.images = {
            "rgb": context.rgb_data.numpy(),
            "depth": context.depth_data.numpy(),
            "segmentation": context.seg_data.numpy(),
        }
        self._depth = context.render_depth.numpy()
        self._depth[:] = self._has_depth
        self._lower, self._upper = context.lower.numpy(), context.upper.numpy()
        self._pixels = _Pixels(context)

    def trace(self, data: mujoco.MjData, appearance: Appearance) -> Images:
        """Returns the images that ``refit_bvh`` and ``render`` make; valid until the next call."""
        still = self._still.of(appearance, data, lambda: self._without_moving(data))
        if still is None:
            self._trace(data)
            return self.images
        touched = self._still.touched(still, data)
        self._trace(data, touched)
        images = {kind: image.copy() for kind, image in still.images.items()}
        for kind, image in images.items():
            image[0, touched] = self.images[kind][0, : len(touched)]
        return images

    def _trace(self, data: mujoco.MjData, pixels: np.ndarray | None = None) -> None:
        self._update_bounds(data)
        self.context.bvh.refit()
        self._trace_rays(pixels)

    def _without_moving(self, data: mujoco.MjData) -> Images:
        """Traces the scene without what moves, depth included."""
        self._update_bounds(data)
        self._lower[self._still.moving] = self._upper[self._still.moving] = _FAR_M
        self.context.bvh.refit()
        self._depth[:] = True
        try:
            self._trace_rays()
        finally:
            self._depth[:] = self._has_depth
        return self.images

    def _update_bounds(self, data: mujoco.MjData) -> None:
        self._bounds.launch()
        self._meshes.write(data)

    def _trace_rays(self, pixels: np.ndarray | None = None) -> None:
        count = self._pixels.choose(pixels)
        if count:
            self.images["segmentation"].fill(-1)
            self.rays.resize((1, count))
            self.rays.launch()


class _Pixels:
    """Which pixels of a context are traced; the first rows of its images are theirs, in their order."""

    def __init__(self, context: Any) -> None:
        self._rays = context.ray.numpy()  # all begin at their camera: their offsets are zero
        self._every = self._rays.copy()
        self._size = context.cam_res.numpy()
        self._own_size = self._size.copy()
        self._starts = [context.rgb_adr.numpy(), context.depth_adr.numpy(), context.seg_adr.numpy()]
        self._own_starts = [starts.copy() for starts in self._starts]
        self._ends = np.cumsum(self._own_size.prod(axis=1))
        self._all = True

    def choose(self, pixels: np.ndarray | None) -> int:
        """Chooses pixels in ascending order, or all; returns how many they are."""
        if pixels is not None:
            ends = np.searchsorted(pixels, self._ends)
            starts = np.concatenate([[0], ends[:-1]])
            self._size[:] = np.stack([ends - starts, np.ones_like(ends)], axis=1)
            np.take(self._every, pixels, axis=0, out=self._rays[: len(pixels)], mode="clip")
            for own, values in zip(self._starts, self._own_starts, strict=True):
                own[:] = np.where(values < 0, values, starts)
            self._all = False
            return len(pixels)
        if not self._all:
            self._size[:] = self._own_size
            self._rays[:] = self._every
            for own, values in zip(self._starts, self._own_starts, strict=True):
                own[:] = values
            self._all = True
        return int(self._ends[-1])


def _start_with_compiler() -> Any:
    """Initializes Warp and returns its module.

    Raises:
        SimulatorError: Warp's compiler for the CPU is not there, as where a copy left out large files.
    """
    wp = start_warp()
    if not wp.is_cpu_available():
        raise SimulatorError(
            "renderer=warp needs Warp's compiler for the CPU, and there is no warp-clang in "
            f"'{Path(wp.__file__).parent / 'bin'}'. Install the package warp-lang again (uv pip install "
            "--reinstall warp-lang), or take renderer=gl, which needs libegl1 and libgl1, or libosmesa6."
        )
    return wp


def _copy(source: mujoco.MjModel | mujoco.MjData, targets: Mapping[str, np.ndarray]) -> None:
    for name, target in targets.items():
        target[...] = np.asarray(getattr(source, name)).reshape(target.shape)


@contextlib.contextmanager
def _compiled_without_nan() -> Iterator[None]:
    """Compiles kernels that are first launched in this context under the assumption of no NaN.

    Minimum and maximum, the main operations of ray traversal, are then one instruction each: an image
    takes a third less time and is bit-identical.
    """
    import warp as wp

    flags = wp.config.cpu_compiler_flags
    wp.config.cpu_compiler_flags = (
        f"{'-march=native' if flags is None else flags} -menable-no-nans -Wno-nan-infinity-disabled"
    )
    try:
        yield
    finally:
        wp.config.cpu_compiler_flags = flags


def ready_for_tracing(model: mujoco.MjModel) -> None:
    """Changes a private copy of a model so that the tracer takes it, whatever it will look like."""
    # Nothing is stepped, and mujoco_warp refuses flags that it has no code for.
    model.opt.disableflags = 0
    # The context keeps what it finds: lights must be typed as widely as they may become.
    model.light_type[1:] = int(mujoco.mjtLightType.mjLIGHT_SPOT)


def create_context(
    model: mujoco.MjModel, cameras: Sequence[str], modalities: Sequence[str], *, num_worlds: int
) -> Any:
    """Returns mujoco_warp's render context for these images on Warp's present device."""
    return tracer_parts().create_render_context(
        model,
        nworld=num_worlds,
        cam_res=[_size_of(model, name) for name in cameras],
        render_rgb="rgb" in modalities,
        render_depth="depth" in modalities,
        render_seg="segmentation" in modalities,
        use_shadows=True,
        enabled_geom_groups=[VISUAL_GROUP, SCENE_GROUP],
        cam_active=list(cameras),
        shadow_light_fraction=0.0,
        background_color=(0.6, 0.65, 0.7, 1.0),
    )


def _size_of(model: mujoco.MjModel, camera: str) -> tuple[int, int]:
    """Returns width and height of a camera's image."""
    width, height = model.cam_resolution[model.camera(camera).id]
    return int(width), int(height)
