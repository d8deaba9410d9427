"""The ray tracer of mujoco_warp without its physics.

``import mujoco_warp`` also defines the kernels of physics, which takes a second of a CPU: four times as long
as the modules of the tracer.
"""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from threading import Lock
from typing import Any, NamedTuple

_PACKAGE = "mujoco_warp"
_IMPORTING = Lock()


class TracerParts(NamedTuple):
    """The functions of mujoco_warp that make images, by their names there."""

    put_model: Callable[..., Any]
    put_data: Callable[..., Any]
    create_render_context: Callable[..., Any]
    refit_bvh: Callable[..., Any]
    render: Callable[..., Any]


def tracer_parts() -> TracerParts:
    """Returns the tracer's functions, which are those of ``mujoco_warp`` for every importer."""
    with _IMPORTING:
        return _tracer_parts()


@cache
def _tracer_parts() -> TracerParts:
    if _PACKAGE in sys.modules:
        return _of_package()
    try:
        return _of_modules()
    except (ImportError, AttributeError):  # another version, with other modules
        return _of_package()


def _of_package() -> TracerParts:
    package = importlib.import_module(_PACKAGE)
    return TracerParts(*(getattr(package, name) for name in TracerParts._fields))


def _of_modules() -> TracerParts:
    """Imports the tracer's modules below an empty package, which a later import of the whole one fills."""
    spec = importlib.util.find_spec(_PACKAGE)
    if spec is None:
        raise ImportError(f"No module named {_PACKAGE!r}")
    sys.modules[_PACKAGE] = importlib.util.module_from_spec(spec)
    try:
        io, bvh, util, render = (
            importlib.import_module(f"{_PACKAGE}._src.{name}")
            for name in ("io", "bvh", "render_util", "render")
        )
    finally:
        del sys.modules[_PACKAGE]
    return TracerParts(io.put_model, io.put_data, util.create_render_context, bvh.refit_bvh, render.render)
