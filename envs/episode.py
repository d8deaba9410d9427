"""One episode of a rollout: what happened in it, step by step.

Shapes: T = control steps, A = action size, D = state size.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, override

import numpy as np

if TYPE_CHECKING:
    from envs.state import State

Columns = dict[str, tuple[slice, tuple[int, ...]]]
"""Part of a flattened state to its columns and its shape."""


@dataclass(slots=True)
class Step:
    """One control step of n environments, shared by the episodes that took it."""

    actions: np.ndarray
    rewards: np.ndarray
    success: np.ndarray
    states: np.ndarray | None  # after the step, (n, D)
    images: dict[str, Any]  # before the step: camera to (n, H, W, 3), an array or a tensor


@dataclass(eq=False, kw_only=True)
class Episode:
    """One episode, under way or over.

    Attributes:
        position: Its place in the list of episodes that :func:`rollout` was given.
        episode: Index in the task's pool.
        env_id: The environment that runs it.
        observations: The newest observations, as many as the actor looks at.
        memory: Whatever the actor keeps for this episode, such as a random generator.
        plan: Actions that are still to be executed.
        instruction: What is to be done, in words.
        initial_state_hash: See :meth:`envs.vector_env.RoboVerseVectorEnv.initial_state_hash`.
        success: Whether the task is solved now; in a demonstration, whether it was after any step.
        solved_at: Steps until the first success, or None.
        episode_return: Sum of the rewards.
        wall_time_s: Wall time, which environments that run at the same time share equally.
    """

    position: int
    episode: int
    env_id: int
    observations: deque[dict[str, np.ndarray]]
    memory: Any = None
    plan: deque[np.ndarray] = field(default_factory=deque)
    instruction: str = ""
    initial_state_hash: str = ""
    success: bool = False
    solved_at: int | None = None
    episode_return: float = 0.0
    wall_time_s: float = 0.0
    _steps: list[tuple[Step, int]] = field(default_factory=list)  # with this episode's row in each
    _initial_state: np.ndarray | None = None
    _columns: Columns = field(default_factory=dict)
    _robots: tuple[str, ...] = ()  # those that act; none is the first of the states

    @property
    def length(self) -> int:
        """Control steps, T."""
        return len(self._steps)

    @property
    def last_action(self) -> np.ndarray | None:
        """The action executed last, (A,); None before the first one."""
        return self._steps[-1][0].actions[self._steps[-1][1]] if self._steps else None

    @property
    def last_state(self) -> np.ndarray | None:
        """The present state, flattened, (D,) float64; None unless states are recorded."""
        step, row = self._steps[-1] if self._steps else (None, 0)
        return self._initial_state if step is None or step.states is None else step.states[row]

    @cached_property
    def actions(self) -> np.ndarray:
        """The action of each step, (T, A): exactly what the environment was given."""
        return np.array([step.actions[row] for step, row in self._steps])

    @cached_property
    def rewards(self) -> np.ndarray:
        """The reward of each step, (T,) float32."""
        return np.array([step.rewards[row] for step, row in self._steps], np.float32)

    @cached_property
    def successes(self) -> np.ndarray:
        """Whether the task is solved after each step, (T,) bool."""
        return np.array([step.success[row] for step, row in self._steps], bool)

    @cached_property
    def raw(self) -> dict[str, np.ndarray]:
        """Recorded flattened states before each step and after the last, each (T + 1, …) float64."""
        after = [step.states[row] for step, row in self._steps if step.states is not None]
        rows: list[Any] = [self._initial_state, *after]
        return unflatten(np.stack(rows), self._columns)

    @property
    def states(self) -> "State":
        """The states of :attr:`raw` in T + 1 rows, on the CPU."""
        return to_state(self.raw)

    @property
    def observation_state(self) -> np.ndarray:
        """Recorded joint positions of the robots that act before each step, (T, J) float32."""
        states = self.states.robots
        joints = [states[name].joint_pos[:-1].numpy() for name in self._robots or list(states)[:1]]
        return np.concatenate(joints, axis=1).astype(np.float32)

    @cached_property
    def images(self) -> Mapping[str, np.ndarray]:
        """Camera to recorded images before each step, (T, H, W, 3) uint8, taken from its device when read."""
        return _Images(self._steps)


class _Images(Mapping[str, np.ndarray]):
    """The images of every camera, which stay on their device until they are read first."""

    def __init__(self, steps: Sequence[tuple[Step, int]]) -> None:
        self._steps, self._read = steps, dict[str, np.ndarray]()
        self._cameras = tuple(steps[0][0].images) if steps else ()

    @override
    def __getitem__(self, camera: str) -> np.ndarray:
        if camera not in self._read:
            self._read[camera] = _stack([step.images[camera][row] for step, row in self._steps])
        return self._read[camera]

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._cameras)

    @override
    def __len__(self) -> int:
        return len(self._cameras)


def unflatten(numbers: np.ndarray, columns: Columns) -> dict[str, np.ndarray]:
    """Returns the parts of flattened states (n, D), each (n, …)."""
    return {key: numbers[:, part].reshape(len(numbers), *shape) for key, (part, shape) in columns.items()}


def to_state(arrays: dict[str, np.ndarray]) -> "State":
    """Returns the state of the arrays that :meth:`envs.state.State.flatten` names."""
    import torch

    from envs.state import State

    return State.unflatten({key: torch.from_numpy(values) for key, values in arrays.items()})


def _stack(images: list[Any]) -> np.ndarray:
    if isinstance(images[0], np.ndarray):
        return np.stack(images)
    import torch

    return torch.stack(images).cpu().numpy()
