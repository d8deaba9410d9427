"""Genesis belongs to a process: it is started once, with one precision, and stays."""

import importlib
import importlib.util
from typing import Any

if importlib.util.find_spec("genesis") is None:  # importing it takes ten seconds, finding it none
    raise ModuleNotFoundError("No module named 'genesis'", name="genesis")

PRECISION = "64"
"""Of what Genesis calculates with. The states that go in and out are float32."""


def part(name: str) -> Any:
    """Returns a module of Genesis, such as ``utils.misc``; what it defines is checked by no type checker."""
    return importlib.import_module(f"genesis.{name}")


def start() -> Any:
    """Returns the module ``genesis``, started on the CPU unless somebody has started it before."""
    gs: Any = importlib.import_module("genesis")
    if not gs._initialized:
        gs.init(backend=gs.cpu, precision=PRECISION, logging_level="error", seed=0)
    return gs
