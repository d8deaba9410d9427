"""Genesis belongs to a process: it is started once, with one precision, and stays."""

import importlib
from typing import Any

PRECISION = "64"
"""Of what Genesis calculates with. The states that go in and out are float32."""


def start() -> Any:
    """Returns the module ``genesis``, started on the CPU unless somebody has started it before."""
    gs: Any = importlib.import_module("genesis")
    if not gs._initialized:
        gs.init(backend=gs.cpu, precision=PRECISION, logging_level="error", seed=0)
    return gs
