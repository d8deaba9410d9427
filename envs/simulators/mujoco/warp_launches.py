"""Launches of Warp's kernels whose arguments are packed once and launched again."""

from collections.abc import Callable
from threading import get_ident
from typing import Any


class Launches:
    """The kernels that a function launches, with the arrays that it gave them.

    ``warp.launch`` checks and packs every argument of every launch; the ray tracer's kernel has eighty, which
    takes as long as tracing some thousand rays.

    Args:
        function: It is run once. What it does beside launching kernels is not repeated. Only one thread may
            record at a time; launches of other threads stay what they are.
    """

    def __init__(self, function: Callable[[], object]) -> None:
        import warp as wp

        self._commands: list[Any] = []
        launch, thread = wp.launch, get_ident()

        def record(*args: Any, **settings: Any) -> None:
            if get_ident() != thread:
                launch(*args, **settings)
                return
            command: Any = launch(*args, **settings, record_cmd=True)
            command.launch()
            self._commands.append(command)

        wp.launch = record
        try:
            function()
        finally:
            wp.launch = launch

    def launch(self) -> None:
        """Launches all kernels, in order."""
        for command in self._commands:
            command.launch()

    def resize(self, dim: tuple[int, ...]) -> None:
        """Gives every kernel another number of threads."""
        for command in self._commands:
            command.set_dim(dim)

    def replace(self, argument: str, value: Any) -> None:
        """Gives every kernel that has this argument another value of it.

        Raises:
            KeyError: No kernel has it.
        """
        having = [
            command
            for command in self._commands
            if any(parameter.label == argument for parameter in command.kernel.adj.args)
        ]
        if not having:
            raise KeyError(argument)
        for command in having:
            command.set_param_by_name(argument, value)
