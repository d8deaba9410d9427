"""Tells a simulator or a renderer that is not installed before anything is written."""

from typing import Any


def check_installed(config: Any) -> None:
    """Imports the simulator and the renderer of a configuration.

    Args:
        config: With ``simulator`` and ``renderer``, which may be the name of a simulator that draws, too.

    Raises:
        MissingExtraError: A package of one is not installed; it says how to install it.
    """
    from envs.simulators import HANDLERS, RENDERERS

    HANDLERS.get(config.simulator)
    (RENDERERS if config.renderer in RENDERERS else HANDLERS).get(config.renderer)
