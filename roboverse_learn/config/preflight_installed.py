"""Tells a simulator or a renderer that is not installed before anything is written."""

from envs.spec import EnvSpec


def check_installed(env: EnvSpec) -> None:
    """Imports the simulator and the renderer of an environment.

    Raises:
        MissingExtraError: A package of one is not installed; it says how to install it.
    """
    from envs.simulators import HANDLERS, RENDERERS

    HANDLERS.get(env.simulator)
    (RENDERERS if env.renderer in RENDERERS else HANDLERS).get(env.renderer)
