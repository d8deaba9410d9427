"""A process that steps a part of the environments: its two ends, and the block that it shares."""

import contextlib
import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
import torch

from envs.core.errors import RoboVerseError, SimulatorError
from envs.scenario import Appearance, ScenarioCfg
from envs.simulators import HANDLERS
from envs.simulators.base import Handler
from envs.state import State

STOP_TIMEOUT_S = 5.0
"""How long a process may take to close its simulator before it is ended."""

Layout = dict[str, tuple[tuple[int, ...], str]]
"""Key of a flattened state to the shape of one row and the type."""


@dataclass(slots=True)
class SharedState:
    """The states of all environments in one block of shared memory.

    Attributes:
        block: The block.
        layout: Key of a flattened state to the shape of one row and the type.
        arrays: Key to its array, (num_envs, …).
        owner: Whether this process made the block.
    """

    block: SharedMemory
    layout: Layout
    arrays: dict[str, np.ndarray]
    owner: bool

    @classmethod
    def create(cls, layout: Layout, num_envs: int) -> "SharedState":
        """Makes a block for ``num_envs`` environments."""
        sizes = [num_envs * int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in layout.values()]
        block = SharedMemory(create=True, size=max(sum(-(-size // 8) * 8 for size in sizes), 8))
        return cls(block, layout, _views(block, layout, num_envs), owner=True)

    @classmethod
    def attach(cls, name: str, layout: Layout, num_envs: int) -> "SharedState":
        """Opens the block of another process."""
        block = SharedMemory(name=name)
        return cls(block, layout, _views(block, layout, num_envs), owner=False)

    @property
    def name(self) -> str:
        """The block's name."""
        return self.block.name

    def free(self) -> None:
        """Lets go of the block, and frees it where it was made."""
        self.arrays = {}
        self.block.close()
        if self.owner:
            self.block.unlink()
            self.owner = False


def _views(block: SharedMemory, layout: Layout, num_envs: int) -> dict[str, np.ndarray]:
    arrays, start = {}, 0
    for key, (shape, kind) in layout.items():
        arrays[key] = np.ndarray((num_envs, *shape), np.dtype(kind), buffer=block.buf, offset=start)
        start += -(-arrays[key].nbytes // 8) * 8
    return arrays


class Worker:
    """A process seen from outside."""

    def __init__(self, context, job: tuple, low: int, high: int) -> None:
        self.low, self.high = low, high
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, dict(os.environ), *job), daemon=True)
        self._process.start()
        theirs.close()

    def send(self, command: str, *arguments: Any) -> None:
        """Sends a command; its answer is the next reply."""
        try:
            self._pipe.send((command, arguments))
        except (BrokenPipeError, ConnectionResetError) as error:
            raise self._ended() from error

    def reply(self) -> Any:
        """Waits for an answer.

        Raises:
            RoboVerseError: the error of the simulator, with the environments of its process.
        """
        try:
            kind, value = self._pipe.recv()
        except (EOFError, ConnectionResetError) as error:
            raise self._ended() from error
        if kind == "error":
            name, message = value
            where = f"environments {self.low} to {self.high - 1}, counted from {self.low}"
            raise _ERRORS.get(name, SimulatorError)(f"{message} (a process of its own: {where})")
        return value

    def _ended(self) -> SimulatorError:
        self._process.join(STOP_TIMEOUT_S)
        return SimulatorError(
            f"The process of environments {self.low} to {self.high - 1} ended (exit code "
            f"{self._process.exitcode}). Run it with num_processes=1 to see why, or with fewer environments."
        )

    def stop(self) -> None:
        """Closes the simulator, and ends the process."""
        with contextlib.suppress(OSError):  # it has ended already
            self._pipe.send(("close", ()))
        self._process.join(STOP_TIMEOUT_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()
        self._pipe.close()


_ERRORS = {kind.__name__: kind for kind in (RoboVerseError, *RoboVerseError.__subclasses__())}


def _serve(
    pipe: Connection,
    environment: dict[str, str],
    simulator: str,
    scenario: ScenarioCfg,
    num_envs: int,
    options: dict,
) -> None:
    """Runs in the process: answers commands until it is told to close."""
    os.environ.clear()
    os.environ.update(environment)
    inside: Inside | None = None

    def start() -> Any:
        nonlocal inside
        inside = Inside(HANDLERS.get(simulator)(scenario, num_envs, **options))
        return inside.layout()

    _answer(pipe, start)
    while inside is not None:
        try:
            command, arguments = pipe.recv()
        except EOFError:  # whoever asked is gone
            command, arguments = "close", ()
        if command == "close":
            break
        _answer(pipe, lambda c=command, a=arguments: getattr(inside, c)(*a))
    if inside is not None:
        inside.close()


def _answer(pipe: Connection, work: Callable[[], Any]) -> None:
    try:
        pipe.send(("value", work()))
    except RoboVerseError as error:
        pipe.send(("error", (type(error).__name__, str(error))))
    except Exception:  # a bug is told where it can be seen, with its traceback
        pipe.send(("error", ("SimulatorError", f"A process failed:\n{traceback.format_exc()}")))


class Inside:
    """The commands, inside the process; environments are counted from its first one."""

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        handler.launch()
        self._shared: SharedState | None = None

    def layout(self) -> Layout:
        """Returns how a row of its states lies in memory."""
        flat = self._handler.get_states([0]).flatten()
        return {key: (tuple(value.shape[1:]), value.numpy().dtype.str) for key, value in flat.items()}

    def share(self, name: str, layout: Layout, num_envs: int, low: int) -> None:
        """Takes the block that its states are written to from now on."""
        self._shared = SharedState.attach(name, layout, num_envs)
        self._low = low
        self._publish(list(range(self._handler.num_envs)))

    def _publish(self, ids: list[int]) -> None:
        assert self._shared is not None, "the block is shared right after the launch"
        rows = np.asarray(ids) + self._low
        for key, value in self._handler.get_states(ids).flatten().items():
            self._shared.arrays[key][rows] = value.cpu().numpy()

    def set_states(self, ids: list[int], flat: dict[str, np.ndarray]) -> None:
        """Sets states of the environments ``ids``."""
        self._handler.set_states(State.unflatten({k: torch.from_numpy(v) for k, v in flat.items()}), ids)
        self._publish(ids)

    def set_poses(self, ids: list[int], poses: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
        """Moves fixed objects and markers."""
        tensors = {name: (torch.from_numpy(p), torch.from_numpy(r)) for name, (p, r) in poses.items()}
        self._handler.set_poses(tensors, ids)
        self._publish(ids)

    def set_joint_targets(self, ids: list[int], targets: dict[str, np.ndarray]) -> None:
        """Sets targets."""
        self._handler.set_joint_targets(targets, ids)
        self._publish(ids)

    def step(self, ids: list[int], num_steps: int) -> None:
        """Advances by physics steps."""
        self._handler.step(num_steps, ids)
        self._publish(ids)

    def step_towards(self, ids: list[int], num_steps: int, targets: dict[str, np.ndarray]) -> None:
        """Advances while targets move."""
        self._handler.step_towards(targets, num_steps, ids)
        self._publish(ids)

    def set_appearance(self, ids: list[int], appearance: Appearance) -> None:
        """Says how one environment looks."""
        self._handler.set_appearance(appearance, ids[0])

    def snapshot(self, ids: list[int]) -> list[Any]:
        """Returns what draws the environments later."""
        return list(self._handler.snapshot(ids))

    def render(self, ids: list[int], cameras: list[str], modalities: tuple[str, ...]) -> dict:
        """Draws the environments."""
        return self._handler.render(cameras, modalities, ids)

    def render_jobs(self, jobs: list[Any], cameras: list[str], modalities: tuple[str, ...]) -> dict:
        """Draws snapshots."""
        return self._handler.render_jobs(jobs, cameras, modalities)

    def fact(self, ids: list[int], name: str) -> Any:
        """Returns a property of the handler."""
        return getattr(self._handler, name)

    def close(self) -> None:
        """Closes the handler and lets go of the block."""
        self._handler.close()
        if self._shared is not None:
            self._shared.free()
