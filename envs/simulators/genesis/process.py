"""Initializes Genesis, once per process, with one precision, for many scenes."""

import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any

if importlib.util.find_spec("genesis") is None:  # importing it takes ten seconds, finding it none
    raise ModuleNotFoundError("No module named 'genesis'", name="genesis")

PRECISION = "64"
"""Precision of Genesis's computations. The states that are set and read are float32."""


def part(name: str) -> Any:
    """Returns a module of Genesis, such as ``utils.misc``; what it defines is checked by no type checker."""
    return importlib.import_module(f"genesis.{name}")


def _runtime() -> Any:
    """Returns what Genesis's compiler holds: its kernels and arrays."""
    return importlib.import_module("quadrants.lang.impl").get_runtime()


SCENES_KEPT = 20
"""Genesis compiles its kernels for each scene and keeps them, 1.5 MiB of a small one: after so many scenes,
and when none is open, it is restarted, which takes a few seconds."""


@dataclass(slots=True)
class _Process:
    """State of Genesis in this process.

    Attributes:
        is_ours: Whether it was started here.
        built: Scenes since the start.
        open: Scenes that are not closed.
    """

    is_ours: bool = False
    built: int = 0
    open: int = 0


_PROCESS = _Process()


def start() -> Any:
    """Returns the module ``genesis`` for one more scene, started on the CPU unless somebody has done so."""
    gs: Any = importlib.import_module("genesis")
    is_full = not _PROCESS.open and _PROCESS.built >= SCENES_KEPT
    if gs._initialized and _PROCESS.is_ours and is_full:
        kernels = tuple(_runtime().kernels)
        gs.destroy()
        for kernel in kernels:
            _forget_arguments(kernel)
    if not gs._initialized:
        gs.init(backend=gs.cpu, precision=PRECISION, logging_level="error", seed=0)
        _PROCESS.is_ours, _PROCESS.built = True, 0
    _PROCESS.built += 1
    _PROCESS.open += 1
    return gs


def end() -> None:
    """Says that a scene is closed for which Genesis was started."""
    _PROCESS.open -= 1


_KINDS = (
    "used_py_dataclass_parameters_by_key_enforcing",
    "_struct_ndarray_launch_info_by_key",
    "_struct_primitive_launch_info_by_key",
)


def _forget_arguments(kernel: Any) -> None:
    """Clears a kernel's cache of argument types, 0.25 MiB of a small scene.

    Restarting Genesis drops a kernel's compiled forms, but not this cache.
    """
    kernel.mapper.mapping.clear()
    for name in _KINDS:
        getattr(kernel, name, {}).clear()


_VIEWS = ("_tc", "_T_tc", "_np", "_T_np")


def forget(state: object) -> None:
    """Frees the arrays of a scene that is about to be destroyed, 2 MiB of a small one.

    Genesis's choice of the fastest kernel keeps the arguments of every scene's calls. An array also keeps a
    view of itself, a reference cycle that the collector does not see; views are made again on demand.

    Args:
        state: ``dyn_state`` of the scene's rigid solver.
    """
    picker = part("engine.solvers.rigid.constraint.solver").func_solve_body
    for kept in vars(picker).values():
        if isinstance(kept, dict | set):
            calls = [call for call in kept if isinstance(call, tuple) and any(each is state for each in call)]
            for call in calls:
                kept.pop(call) if isinstance(kept, dict) else kept.discard(call)
    picker._cached_args = picker._cached_kwargs = picker._cached_impl = None
    for array in tuple(_runtime().ndarrays):
        for view in _VIEWS:
            vars(array).pop(view, None)
