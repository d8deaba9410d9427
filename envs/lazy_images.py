"""Pictures that are drawn when somebody reads them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np


class LazyPixels(dict):
    """A dict from camera to picture that draws all of them when the first one is read.

    It shows the moment at which it was made, however many steps have been taken since, and is a plain
    dict to everybody who checks, pickles or compares it.

    Args:
        cameras: Names of the cameras: the keys.
        draw: Draws the pictures; called once at most.
    """

    def __init__(self, cameras: Iterable[str], draw: Callable[[], dict[str, np.ndarray]]) -> None:
        super().__init__(dict.fromkeys(cameras))
        self._draw: Callable[[], dict[str, np.ndarray]] | None = draw

    @property
    def drawn(self) -> bool:
        """Whether the pictures exist."""
        return self._draw is None

    def _materialize(self) -> None:
        if self._draw is not None:
            pictures, self._draw = self._draw(), None
            super().update(pictures)

    def __getitem__(self, camera: str) -> np.ndarray:
        if camera in self:
            self._materialize()
        return super().__getitem__(camera)

    def get(self, camera: str, default=None):
        """Returns the picture of ``camera``, or ``default``."""
        if camera in self:
            self._materialize()
        return super().get(camera, default)

    def values(self):
        """Returns the pictures."""
        self._materialize()
        return super().values()

    def items(self):
        """Returns cameras and pictures."""
        self._materialize()
        return super().items()

    def copy(self) -> dict[str, np.ndarray]:
        """Returns a plain dict."""
        return dict(self.items())

    def __iter__(self) -> Iterator[str]:
        return super().__iter__()

    def __eq__(self, other: object) -> bool:
        self._materialize()
        return super().__eq__(other)

    __hash__ = None  # type: ignore[assignment]

    def __deepcopy__(self, memo: dict) -> "LazyPixels":
        """Returns one whose pictures are drawn: Gymnasium's checker compares types, too."""
        pictures = {camera: picture.copy() for camera, picture in self.items()}
        drawn = LazyPixels(pictures, lambda: pictures)
        drawn._materialize()
        return drawn

    def __reduce__(self):
        return dict, (self.copy(),)


def row_of(observation: Mapping[str, Any], env_id: int) -> dict[str, Any]:
    """Returns one environment's part of a batched observation; pictures stay undrawn."""
    out: dict[str, Any] = {}
    for key, value in observation.items():
        if isinstance(value, LazyPixels):
            out[key] = LazyPixels(value, lambda pixels=value: {c: p[env_id] for c, p in pixels.items()})
        else:
            out[key] = value[env_id]
    return out
