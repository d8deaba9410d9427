"""Appearances of worlds, as rows of the arrays that the ray tracer reads."""

import dataclasses
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.mjcf.model import OBJECT_MATERIAL
from envs.rotations import from_yaw, to_matrix
from envs.scenario import SURFACES, Appearance
from envs.simulators.mujoco.render import Stage
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.textures import TextureTable

LIGHTS = (
    "light_type",
    "light_active",
    "light_castshadow",
    "light_pos",
    "light_dir",
    "light_diffuse",
    "light_specular",
    "light_ambient",
    "light_cutoff",
    "light_exponent",
)
MATERIALS = ("mat_rgba", "mat_specular", "mat_shininess", "mat_texrepeat")
CAMERAS = ("cam_pos", "cam_quat")
FURNITURE = ("geom_size", "geom_rgba")
TEXTURES = "mat_texid"

PER_WORLD = (*LIGHTS, *MATERIALS, *CAMERAS, *FURNITURE, TEXTURES)
"""Fields of the model of which every world has its own."""

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)

_KEPT_APPEARANCES = 4096
"""Appearances whose arrays are kept, about 10 KiB each."""


@dataclasses.dataclass(frozen=True, slots=True)
class _Arrays:
    """The arrays of one appearance: field to values, without a first axis for worlds."""

    appearance: Appearance
    values: dict[str, np.ndarray]
    textures: tuple[str | None, ...]


class AppearanceWriter:
    """Writes the appearances of worlds into the ray tracer's model, only the rows that change.

    Args:
        stage: Writes an appearance into a model's arrays, as for every other renderer.
        model: The ray tracer's model, whose fields :data:`PER_WORLD` have ``num_worlds`` rows.
        num_worlds: How many.
        textures: Images of the materials.
        device: Where the model is.

    Attributes:
        table_quat: Orientation of each world's table top, (num_worlds, 4).
        furniture_pos: Positions of its furniture's geoms, (num_worlds, num_slots, 3).
        furniture_mat: Their orientations, (num_worlds, num_slots, 3, 3).
    """

    def __init__(
        self, stage: Stage, model: Any, num_worlds: int, textures: TextureTable, device: Device
    ) -> None:
        self._stage, self._textures, self._device = stage, textures, device
        self._fields = {name: device.tensor(getattr(model, name)) for name in PER_WORLD}
        self._surfaces = [stage.model.material(surface).id for surface in SURFACES]
        self._materials = [*self._surfaces, stage.model.material(OBJECT_MATERIAL).id]
        self._slots = stage.furniture.geoms
        self._written: list[_Arrays | None] = [None] * num_worlds
        self._looks: OrderedDict[int, _Arrays] = OrderedDict()
        self.table_quat = torch.zeros((num_worlds, 4), device=device.torch)
        self.furniture_pos = torch.zeros((num_worlds, len(self._slots), 3), device=device.torch)
        self.furniture_mat = torch.zeros((num_worlds, len(self._slots), 3, 3), device=device.torch)
        self._poses = {name: getattr(self, name) for name in ("table_quat", "furniture_pos", "furniture_mat")}

    def write(self, appearances: Sequence[Appearance]) -> bool:
        """Sets the appearances of the first worlds, one each; returns whether any changed."""
        written = self._written
        rows = [
            row
            for row, appearance in enumerate(appearances)
            if (look := written[row]) is None or look.appearance is not appearance
        ]
        if not rows:
            return False
        looks = [self._look(appearances[row]) for row in rows]
        for row, look in zip(rows, looks, strict=True):
            written[row] = look
        index = self._device.rows(rows)
        for name in (*LIGHTS, *CAMERAS):
            self._fields[name][index] = self._stacked(looks, name, self._fields[name].dtype)
        columns = torch.tensor(self._materials, device=self._device.torch)
        for name in MATERIALS:
            self._fields[name][index[:, None], columns] = self._stacked(looks, name, torch.float32)
        columns = torch.from_numpy(self._slots).to(self._device.torch)
        for name in FURNITURE:
            self._fields[name][index[:, None], columns] = self._stacked(looks, name, torch.float32)
        for name, kept in self._poses.items():
            kept[index] = self._stacked(looks, name, torch.float32)
        self._write_textures(index, looks)
        return True

    def _write_textures(self, index: Tensor, looks: Sequence[_Arrays]) -> None:
        names = [name for look in looks for name in look.textures]
        others = {name for look in self._written if look is not None for name in look.textures if name}
        ids = torch.tensor(self._textures.ids_of(names, others), dtype=torch.int32)
        surfaces = torch.tensor(self._surfaces, device=self._device.torch)
        table = ids.view(len(looks), -1).to(self._device.torch)
        self._fields[TEXTURES][index[:, None], surfaces, _RGB] = table

    def _stacked(self, looks: Sequence[_Arrays], name: str, dtype: torch.dtype) -> Tensor:
        values = torch.from_numpy(np.stack([look.values[name] for look in looks]))
        return values.to(device=self._device.torch, dtype=dtype)

    def _look(self, appearance: Appearance) -> _Arrays:
        known = self._looks.get(id(appearance))
        if known is not None:  # it holds its appearance, so no other object has this id
            self._looks.move_to_end(id(appearance))
            return known
        self._stage.dress(appearance)
        model = self._stage.model
        values = {name: np.array(getattr(model, name)) for name in (*LIGHTS, *CAMERAS)}
        values |= {name: getattr(model, name)[self._materials].copy() for name in MATERIALS}
        values |= {name: getattr(model, name)[self._slots].copy() for name in FURNITURE}
        values["furniture_pos"] = model.geom_pos[self._slots].copy()
        values["furniture_mat"] = to_matrix(model.geom_quat[self._slots])
        values["table_quat"] = from_yaw(appearance.table_yaw_rad)
        textures = tuple(self._stage.surface_textures[surface] for surface in SURFACES)
        look = self._looks[id(appearance)] = _Arrays(appearance, values, textures)
        if len(self._looks) > _KEPT_APPEARANCES:
            self._looks.popitem(last=False)
        return look
