"""The loss of a LeRobot policy, of which the repeated blocks of its networks are compiled.

LeRobot's losses tokenize, look values up by name and ask for numbers, so they are no single graph. Most of
their time goes into blocks that follow each other, such as the layers of a vision encoder. Blocks of one
class share one compiled function, so that compiling takes seconds, not minutes as for the whole network.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, override

import torch
from torch import Tensor, nn

from policies.compilation import OBJECTIVE_OPTIONS
from policies.objective import Loss, Objective


class BlockwiseObjective(Objective):
    """Raw frames to the loss; ``compile`` compiles the members of every list of modules of the network.

    Outside of this loss, as in acting, the network stays as it is. So what is computed again in the backward
    pass (gradient checkpointing) is not compiled.
    """

    _compiled: tuple[tuple[nn.Module, Callable[..., Any]], ...] = ()

    @override
    def compile(self, *, options: dict[str, Any] | None = None, **_: Any) -> None:
        """Compiles the blocks, each when it is first called; see :meth:`torch.nn.Module.compile`.

        Args:
            options: Further ones of the compiler. What else is wanted of a whole loss is no block's.
        """
        lists = [module for module in self.model.modules() if isinstance(module, nn.ModuleList)]
        blocks = dict.fromkeys(block for members in lists for block in members if _is_block(block))
        self._compiled = tuple(
            (block, torch.compile(block.forward, options=OBJECTIVE_OPTIONS | (options or {})))
            for block in blocks
        )

    @override
    def forward(self, batch: dict[str, Tensor]) -> Loss:
        with self._in_place():
            return super().forward(batch)

    @contextmanager
    def _in_place(self) -> Iterator[None]:
        """While it lasts, blocks run as they were compiled."""
        for block, compiled in self._compiled:
            block.forward = compiled
        try:
            yield
        finally:
            for block, _ in self._compiled:
                del block.forward  # the class's own again


def _is_block(module: nn.Module) -> bool:
    """Returns whether a member of a list has parts, and is not computed again in the backward pass."""
    return any(module.children()) and not getattr(module, "gradient_checkpointing", False)
