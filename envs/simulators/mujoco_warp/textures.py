"""Images of materials on the device: one table that every world points into."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from envs.core.errors import SimulatorError
from envs.mjcf.model import TEXTURE_SIZE
from envs.simulators.base import TextureSource
from envs.simulators.mujoco.render import texture_of
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.settings import SIMULATOR

NO_TEXTURE = -1


class TextureTable:
    """Loads an image at its first use, and evicts the least recently used one.

    Args:
        first: The model's own textures, which keep their places.
        source: Gives the image of a named material.
        capacity: How many images of materials are kept.
        device: Where.

    Attributes:
        array: What the ray tracer reads; always the same memory, so that graphs stay valid.
    """

    def __init__(
        self, first: Sequence[Any], source: TextureSource | None, capacity: int, device: Device
    ) -> None:
        self._source, self._device, self._first = source, device, len(first)
        with device.scope():
            blank = self._texture(None)
            self._textures = [*first, *[blank] * capacity]
            self.array = wp.array(self._textures, dtype=wp.Texture2D)
        self._free = list(range(len(self._textures) - 1, self._first - 1, -1))
        self._ids: dict[str, int] = {}  # in the order of their last use

    def __len__(self) -> int:
        return len(self._ids)

    def ids_of(self, names: Sequence[str | None], worn: set[str]) -> list[int]:
        """Returns the place of each image; -1 for none.

        Args:
            names: Materials.
            worn: Materials that other worlds wear now; these stay.

        Raises:
            SimulatorError: if more images are worn at once than there are places.
        """
        keep = worn | {name for name in names if name is not None}
        changed = False
        for name in dict.fromkeys(name for name in names if name is not None):
            if name in self._ids:
                self._ids[name] = self._ids.pop(name)
                continue
            place = self._free.pop() if self._free else self._drop(keep)
            with self._device.scope():
                self._textures[place] = self._texture(name)
            self._ids[name] = place
            changed = True
        if changed:
            with self._device.scope():
                self.array.assign(wp.array(self._textures, dtype=wp.Texture2D))
        return [NO_TEXTURE if name is None else self._ids[name] for name in names]

    def _drop(self, keep: set[str]) -> int:
        name = next((name for name in self._ids if name not in keep), None)
        if name is None:
            raise SimulatorError(
                f"The worlds wear more than {len(self._ids)} different materials at once. In the scenario, "
                f"set simulators['{SIMULATOR}']['num_textures'] to at least {len(keep)}."
            )
        self._device.synchronize()  # no kernel may still read it
        return self._ids.pop(name)

    def _texture(self, name: str | None) -> Any:
        pixels = np.full((TEXTURE_SIZE, TEXTURE_SIZE, 4), 255, np.uint8)
        pixels[..., :3] = texture_of(name, self._source)
        return wp.Texture2D(wp.array(pixels, dtype=wp.uint8), filter_mode=wp.TextureFilterMode.LINEAR)
