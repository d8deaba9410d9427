"""Images by MuJoCo's OpenGL rasterizer: through EGL, or OSMesa where there is no EGL."""

import importlib
import os
import sys
from collections.abc import Sequence
from typing import override

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.scenario import SURFACES, Appearance
from envs.simulators.mujoco.render import RenderJob, fixed_view, metres_of_reversed_depth, texture_of
from envs.simulators.mujoco.render_one_by_one import StagedRenderer

_PLATFORM = "PYOPENGL_PLATFORM"
"""Variable by which PyOpenGL chooses a library when it is first imported; MuJoCo sets it."""

_SEGMENT_FLAGS = (int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR))


class GlRenderer(StagedRenderer):
    """One OpenGL context, which belongs to the thread that renders first."""

    not_shown = ("metallic", "lamp_shape")

    def __init__(self, model, scenario, *, textures=None, num_threads: int = 0) -> None:
        super().__init__(model, scenario, textures=textures, num_threads=num_threads)
        view = self._stage.model.vis.global_
        view.offwidth = max(camera.width for camera in scenario.cameras)
        view.offheight = max(camera.height for camera in scenario.cameras)
        self._gl = _open_context(view.offwidth, view.offheight)
        self._gl.make_current()
        self._context = mujoco.MjrContext(self._stage.model, int(mujoco.mjtFontScale.mjFONTSCALE_100))
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._context.readDepthMap = int(mujoco.mjtDepthMap.mjDEPTH_ZEROFAR)
        self._scene = mujoco.MjvScene(self._stage.model, maxgeom=2000)
        self._option, self._camera = fixed_view()
        self._uploaded: dict[str, str | None] = dict.fromkeys(SURFACES)

    @override
    def render(
        self, jobs: Sequence[RenderJob], cameras: tuple[str, ...], modalities: tuple[str, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        self._gl.make_current()
        return super().render(jobs, cameras, modalities)

    @override
    def dress(self, appearance: Appearance) -> None:
        model = self._stage.model
        for surface in SURFACES:
            name = self._stage.surface_textures[surface]
            if name != self._uploaded[surface]:
                texture = model.texture(surface)
                size = int(texture.height[0] * texture.width[0] * texture.nchannel[0])
                first = int(model.tex_adr[texture.id])
                model.tex_data[first : first + size] = texture_of(name, self.textures).ravel()
                mujoco.mjr_uploadTexture(model, self._context, texture.id)
                self._uploaded[surface] = name

    @override
    def pose(self, cameras: tuple[str, ...]) -> None:
        pass  # the stage's own data is rendered

    @override
    def draw(self, camera: str, out: dict[str, np.ndarray], index: int) -> None:
        stage, scene = self._stage, self._scene
        self._camera.fixedcamid = stage.model.camera(camera).id
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(stage.model, stage.data, self._option, None, self._camera, everything, scene)
        width, height = (int(v) for v in stage.model.cam_resolution[self._camera.fixedcamid])
        window = mujoco.MjrRect(0, 0, width, height)
        if "rgb" in out:
            image = np.empty((height, width, 3), np.uint8)
            mujoco.mjr_render(window, scene, self._context)
            mujoco.mjr_readPixels(image, None, window, self._context)
            out["rgb"][index] = image[::-1]
        if "depth" in out or "segmentation" in out:
            self._draw_geometry(window, out, index)

    def _draw_geometry(self, window: mujoco.MjrRect, out: dict[str, np.ndarray], index: int) -> None:
        scene = self._scene
        before = scene.flags.copy()
        scene.flags[list(_SEGMENT_FLAGS)] = True
        mujoco.mjr_render(window, scene, self._context)
        scene.flags[:] = before
        ids = np.empty((window.height, window.width, 3), np.uint8)
        depth = np.empty((window.height, window.width), np.float32)
        mujoco.mjr_readPixels(ids, depth, window, self._context)
        if "depth" in out:
            extent, clip = self._stage.model.stat.extent, self._stage.model.vis.map
            metres = metres_of_reversed_depth(depth, clip.znear * extent, clip.zfar * extent)
            out["depth"][index] = metres[::-1]
        if "segmentation" in out:
            # Colours are segment ids counted from 1; 0 is the background.
            segments = (ids.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32))[::-1]
            geom_of_segment = np.full(scene.ngeom + 1, -1, np.int32)
            for geom in scene.geoms[: scene.ngeom]:
                if geom.segid >= 0 and geom.objtype == int(mujoco.mjtObj.mjOBJ_GEOM):
                    geom_of_segment[geom.segid + 1] = geom.objid
            out["segmentation"][index] = self.segment(geom_of_segment[segments])

    @override
    def close(self) -> None:
        self._context.free()
        self._gl.free()


def _open_context(width: int, height: int):
    """Opens an off-screen context by ``MUJOCO_GL``, or else by the first of EGL and OSMesa that works."""
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    backends = (chosen,) if chosen in ("egl", "osmesa", "glfw") else ("egl", "osmesa")
    reasons = []
    platform = os.environ.get(_PLATFORM)
    for backend in backends:
        try:
            return importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        except Exception as error:  # each backend fails with errors of its own
            reasons.append(f"{backend}: {error}")
            _forget_platform(platform)
    raise SimulatorError(
        f"renderer=gl found no OpenGL ({'; '.join(reasons)}). Install libegl1 and libgl1, or libosmesa6, "
        "or take renderer=warp, which needs no system package."
    )


def _forget_platform(before: str | None) -> None:
    """Lets PyOpenGL choose its library again: what a backend that failed chose serves no other one."""
    os.environ.pop(_PLATFORM, None)
    if before is not None:
        os.environ[_PLATFORM] = before
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
