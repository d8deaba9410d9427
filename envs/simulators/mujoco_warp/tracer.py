"""Images of many worlds at once, ray-traced straight into torch tensors."""

import contextlib
import copy
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
from torch import Tensor

from envs.mjcf.model import TABLE_BODY
from envs.scenario import Appearance, ScenarioCfg
from envs.simulators.base import TextureSource
from envs.simulators.mujoco.render import Stage, segmentation_of_geoms
from envs.simulators.mujoco.render_warp import create_context, ready_for_tracing
from envs.simulators.mujoco_warp.appearances import PER_WORLD, AppearanceWriter
from envs.simulators.mujoco_warp.device import Device, Graph
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.simulators.mujoco_warp.textures import TextureTable
from envs.simulators.mujoco_warp.worlds import put_model

TILE = 16
"""Pixels a side of a tile. Threads that run in step trace rays of one tile, which meet the same things: on an
H200 1,024 worlds take 26 and 77 ms at 128² and 256², and row by row 43 and 123."""

Images = dict[str, dict[str, Tensor]]
"""Camera to modality to images (n, H, W, …); see :meth:`envs.simulators.base.Handler.render`."""


class BatchTracer:
    """mujoco_warp's ray tracer over many worlds, each with its own appearance.

    It has its own model and positions: images may show another state than the physics', and the table top,
    which turns in images only, does not turn under the robot.

    Args:
        model: The compiled scene; it is never written to.
        scenario: What it was compiled from.
        device: Where.
        settings: How many worlds at once, how many textures.
        num_envs: The most worlds that will be rendered, as a hint.
        textures: Gives the image of a named material.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scenario: ScenarioCfg,
        device: Device,
        settings: WarpSettings,
        num_envs: int,
        textures: TextureSource | None,
    ) -> None:
        self._scenario, self._device, self._settings = scenario, device, settings
        self._source = textures
        self._capacity = min(num_envs, settings.render_worlds)
        stage = Stage(model, scenario)
        self._mj = stage.model
        ready_for_tracing(self._mj)
        with device.scope(), contextlib.redirect_stdout(io.StringIO()):
            self._model = put_model(self._mj, dict.fromkeys(PER_WORLD, self._capacity))
            self._data = mjw.make_data(self._mj, nworld=self._capacity, nconmax=1, njmax=1)
        self._qpos, self._mocap_pos, self._mocap_quat, self._geom_xpos, self._geom_xmat = (
            device.tensor(getattr(self._data, name))
            for name in ("qpos", "mocap_pos", "mocap_quat", "geom_xpos", "geom_xmat")
        )
        self._slots = torch.from_numpy(stage.furniture.geoms).to(device.torch)
        self._table = int(self._mj.body(TABLE_BODY).mocapid[0]) if scenario.table is not None else -1
        self._contexts: dict[tuple, _Context] = {}
        self._textures: TextureTable | None = None
        self._stage = stage
        names, of_geom = segmentation_of_geoms(model, scenario)
        self.segmentation_names = names
        self._of_geom = torch.from_numpy(of_geom).to(device.torch)

    def draw(
        self,
        qpos: Tensor,
        mocap_pos: Tensor,
        mocap_quat: Tensor,
        appearances: Sequence[Appearance],
        cameras: tuple[str, ...],
        modalities: tuple[str, ...],
        out: Mapping[str, Mapping[str, Tensor]] | None = None,
    ) -> Images:
        """Renders worlds.

        Args:
            qpos: Joint positions, (n, nq).
            mocap_pos: Positions of the bodies that are put in place, (n, nmocap, 3).
            mocap_quat: Their orientations, (n, nmocap, 4).
            appearances: How each of them looks, n.
            cameras: Names of cameras.
            modalities: Of :data:`envs.simulators.base.MODALITIES`.
            out: Tensors to render into, which may be parts of larger ones; new ones by default.
        """
        images = self._empty(len(appearances), cameras, modalities) if out is None else out
        with self._device.scope():
            context = self._context(cameras, modalities)
            for first in range(0, len(appearances), self._capacity):
                part = slice(first, min(first + self._capacity, len(appearances)))
                count = part.stop - part.start
                if self._writer.write(appearances[part]):
                    # The tracer's own kinematics leaves alone what is fixed to the world.
                    self._geom_xpos[:, self._slots] = self._writer.furniture_pos
                    self._geom_xmat[:, self._slots] = self._writer.furniture_mat
                self._qpos[:count] = qpos[part]
                self._mocap_pos[:count] = mocap_pos[part]
                self._mocap_quat[:count] = mocap_quat[part]
                if self._table >= 0:
                    self._mocap_quat[:count, self._table] = self._writer.table_quat[:count]
                self._trace(context, count)
                context.fetch(images, part, self._of_geom)
        return {camera: dict(kinds) for camera, kinds in images.items()}

    def _trace(self, context: "_Context", count: int) -> None:
        if count < self._capacity or not self._device.is_cuda:
            self._launch(context, count)
            return
        if context.graph is None:
            context.graph = self._device.capture(lambda: self._launch(context, count))
        context.graph.launch()

    def _launch(self, context: "_Context", count: int) -> None:
        data = self._data
        if count < self._capacity:  # the first worlds alone
            data = copy.copy(data)
            data.nworld = count
        mjw.kinematics(self._model, data)
        mjw.camlight(self._model, data)
        mjw.refit_bvh(self._model, data, context.context)
        mjw.render(self._model, data, context.context)

    def _context(self, cameras: tuple[str, ...], modalities: tuple[str, ...]) -> "_Context":
        key = (cameras, modalities)
        if key not in self._contexts:
            sizes = {camera.name: (camera.width, camera.height) for camera in self._scenario.cameras}
            with contextlib.redirect_stdout(io.StringIO()):
                context = create_context(self._mj, cameras, modalities, num_worlds=self._capacity)
            if self._textures is None:
                self._textures = TextureTable(
                    context.textures_registry, self._source, self._settings.num_textures, self._device
                )
                self._writer = AppearanceWriter(
                    self._stage, self._model, self._capacity, self._textures, self._device
                )
            context.textures = self._textures.array
            self._contexts[key] = _Context(
                context, [_Camera.of(n, *sizes[n], self._device) for n in cameras], modalities, self._device
            )
        return self._contexts[key]

    def _empty(self, count: int, cameras: tuple[str, ...], modalities: tuple[str, ...]) -> Images:
        kinds = {"rgb": ((3,), torch.uint8), "depth": ((), torch.float32), "segmentation": ((), torch.int32)}
        sizes = {camera.name: (camera.height, camera.width) for camera in self._scenario.cameras}
        return {
            name: {
                modality: torch.empty(
                    (count, *sizes[name], *kinds[modality][0]),
                    dtype=kinds[modality][1],
                    device=self._device.torch,
                )
                for modality in modalities
            }
            for name in cameras
        }


@dataclass(frozen=True, slots=True)
class _Camera:
    """A camera and where its pixels, row by row, lie among those that were traced tile by tile."""

    name: str
    width: int
    height: int
    places: Tensor

    @classmethod
    def of(cls, name: str, width: int, height: int, device: Device) -> "_Camera":
        places = torch.from_numpy(np.argsort(by_tiles(width, height)))
        return cls(name, width, height, places.to(device.torch))


def by_tiles(width: int, height: int) -> np.ndarray:
    """Returns the pixels of an image, counted row by row, tile by tile; (height · width,) int."""
    y, x = np.divmod(np.arange(height * width), width)
    return np.lexsort((x, y, x // TILE, y // TILE))


@dataclass(slots=True)
class _Context:
    """Buffers of one choice of cameras and modalities, and its graph once there is one."""

    context: Any
    cameras: list[_Camera]
    modalities: tuple[str, ...]
    device: Device
    graph: Graph | None = None

    def __post_init__(self) -> None:
        """Puts the rays of every image in the order in which they are to be traced."""
        start = 0
        for camera in self.cameras:
            span = slice(start, start + len(camera.places))
            for rays in (self.device.tensor(self.context.ray), self.device.tensor(self.context.ray_offset)):
                rays[span] = rays[span][camera.places.argsort()]
            start = span.stop

    def fetch(self, images: Mapping[str, Mapping[str, Tensor]], rows: slice, of_geom: Tensor) -> None:
        """Copies the rendered pixels to ``rows`` of the images."""
        count, start = rows.stop - rows.start, 0
        for camera in self.cameras:
            span = slice(start, start + len(camera.places))
            shape, out = (count, camera.height, camera.width), images[camera.name]
            if "rgb" in self.modalities:
                # One number per pixel, its bytes blue, green, red and opacity.
                packed = self._rows(self.context.rgb_data, count, span)[:, camera.places]
                out["rgb"][rows] = packed.view(torch.uint8).view(*shape, 4)[..., :3].flip(-1)
            if "depth" in self.modalities:
                depth = self._rows(self.context.depth_data, count, span)[:, camera.places]
                out["depth"][rows] = depth.view(shape)
            if "segmentation" in self.modalities:
                ids = self._rows(self.context.seg_data, count, span)[:, camera.places, 0]
                out["segmentation"][rows] = of_geom[ids.long()].view(shape)
            start = span.stop

    def _rows(self, buffer: Any, count: int, span: slice) -> Tensor:
        """Returns what was traced for a camera in the first worlds, (count, pixels, …)."""
        return self.device.tensor(buffer)[:count, span]
