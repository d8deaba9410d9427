"""Images that are rendered when they are first read."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np


class LazyPixels(dict):
    """A dict from camera to image that renders all images when the first one is read.

    The images show the time at which it was made, however many steps have been taken since. It checks,
    pickles and compares like a plain dict.

    Args:
        cameras: Names of the cameras: the keys.
        draw: Renders the images; called at most once.
    """

    def __init__(self, cameras: Iterable[str], draw: Callable[[], dict[str, np.ndarray]]) -> None:
        super().__init__(dict.fromkeys(cameras))
        self._draw: Callable[[], dict[str, np.ndarray]] | None = draw

    @property
    def drawn(self) -> bool:
        """Whether the images have been rendered."""
        return self._draw is None

    def _materialize(self) -> None:
        if self._draw is not None:
            images, self._draw = self._draw(), None
            super().update(images)

    def __getitem__(self, camera: str) -> np.ndarray:
        if camera in self:
            self._materialize()
        return super().__getitem__(camera)

    def get(self, camera: str, default=None):
        """Returns the image of ``camera``, or ``default``."""
        if camera in self:
            self._materialize()
        return super().get(camera, default)

    def values(self):
        """Returns the images."""
        self._materialize()
        return super().values()

    def items(self):
        """Returns cameras and images."""
        self._materialize()
        return super().items()

    def copy(self) -> dict[str, np.ndarray]:
        """Returns a plain dict."""
        return dict(self.items())

    def __eq__(self, other: object) -> bool:
        self._materialize()
        return super().__eq__(other)

    __hash__ = None  # type: ignore[assignment]

    def __deepcopy__(self, memo: dict) -> "LazyPixels":
        """Returns a rendered copy of the same type, which Gymnasium's checker compares."""
        images = {camera: image.copy() for camera, image in self.items()}
        drawn = LazyPixels(images, lambda: images)
        drawn._materialize()
        return drawn

    def __reduce__(self):
        return dict, (self.copy(),)


def row_of(observation: Mapping[str, Any], env_id: int) -> dict[str, Any]:
    """Returns one environment's part of a batched observation; images are not rendered."""
    out: dict[str, Any] = {}
    for key, value in observation.items():
        if isinstance(value, LazyPixels):
            out[key] = LazyPixels(value, lambda pixels=value: {c: p[env_id] for c, p in pixels.items()})
        else:
            out[key] = value[env_id]
    return out
