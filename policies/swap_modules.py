"""Networks of which some modules are exchanged."""

from collections.abc import Callable

from torch import nn


def replace_modules[M: nn.Module](network: nn.Module, old: type[M], make: Callable[[M], nn.Module]) -> None:
    """Replaces every ``old`` module below a network by ``make`` of it."""
    for name, child in network.named_children():
        if isinstance(child, old):
            setattr(network, name, make(child))
        else:
            replace_modules(child, old, make)
