"""Images that are rendered when they are first read."""

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np


def _rendered(name: str) -> Any:
    """Returns the method of a dict that renders the images before it reads or changes them."""
    method = getattr(dict, name)

    @functools.wraps(method)
    def read(self: "LazyPixels", *args: Any, **kwargs: Any) -> Any:
        self._materialize()
        return method(self, *args, **kwargs)

    return read


class LazyPixels(dict):
    """A dict from camera to image that renders all images when the first one is read.

    The images show the time at which it was made, however many steps have been taken since. It checks and
    pickles like a plain dict, and equals a dict of the same cameras whose images have the same pixels.

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

    values, items = _rendered("values"), _rendered("items")
    pop, popitem, clear = _rendered("pop"), _rendered("popitem"), _rendered("clear")
    setdefault, update = _rendered("setdefault"), _rendered("update")
    __setitem__, __delitem__ = _rendered("__setitem__"), _rendered("__delitem__")
    __or__, __ror__, __ior__ = _rendered("__or__"), _rendered("__ror__"), _rendered("__ior__")
    __repr__ = _rendered("__repr__")
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        """Compares the pixels; images are rendered only where the cameras are the same."""
        if not isinstance(other, dict):
            return NotImplemented
        same_cameras = self.keys() == other.keys()
        return same_cameras and all(np.array_equal(self[camera], other[camera]) for camera in self)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __iter__(self) -> Iterator[str]:
        """Iterates over cameras. With it ``dict(...)`` and ``**`` read images by :meth:`__getitem__`."""
        return super().__iter__()

    def copy(self) -> dict[str, np.ndarray]:
        """Returns a plain dict."""
        return dict(self.items())

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


def rows_of(observation: Mapping[str, Any], chosen: np.ndarray) -> np.ndarray:
    """Returns the parts of chosen environments, (N,) objects; None where ``chosen`` (N,) bool is not set."""
    rows = np.full(len(chosen), None, dtype=object)
    for env_id in chosen.nonzero()[0]:
        rows[env_id] = row_of(observation, int(env_id))
    return rows
