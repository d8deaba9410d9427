"""Interface of every policy for running and saving it."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol, runtime_checkable

from envs.core.errors import PolicyError

if TYPE_CHECKING:
    import numpy as np
    import torch

type Observation = Mapping[str, "np.ndarray"]


def listed(names: Iterable[str]) -> str:
    """Names as one would type a list of them on the command line."""
    return f"[{','.join(names)}]"


def observed(
    observation: Observation,
    key: str,
    shape: Sequence[int],
    policy: str,
    dtype: "type[np.generic] | None" = None,
) -> "np.ndarray":
    """Returns what an observation holds under a key, where it is what a policy was made for.

    Args:
        observation: Arrays (n, …) by key.
        key: Which one.
        shape: Of one environment's entry: all axes after the first.
        policy: Its name, for messages.
        dtype: Of the entries; None takes any.

    Raises:
        PolicyError: if the key is absent, or the array is of another shape or kind.
    """
    import numpy as np

    advice = "Use the task, robot, cameras and image_size that it was trained with."
    if key not in observation:
        raise PolicyError(
            f"The observation has no '{key}', which policy '{policy}' needs. "
            f"Given: {', '.join(sorted(observation)) or 'nothing'}. {advice}"
        )
    array = np.asarray(observation[key])
    if array.shape[1:] != tuple(shape):
        raise PolicyError(
            f"'{key}' has shape {array.shape}, but policy '{policy}' was made for "
            f"(n, {', '.join(map(str, shape))}). {advice}"
        )
    if dtype is not None and array.dtype != dtype:
        raise PolicyError(
            f"'{key}' is {array.dtype}, but policy '{policy}' was made for {np.dtype(dtype)}. {advice}"
        )
    return array


@runtime_checkable
class Policy(Protocol):
    """A function from observations to a chunk of actions.

    A policy keeps nothing between calls: the caller holds the last ``n_obs_steps`` observations
    and executes the ``n_action_steps`` actions of a chunk before asking again.

    Attributes:
        name: Registered name.
        actions_of: What its actions mean: ``task`` for the task's own controller, ``rl`` for the actions
            scaled to [-1, 1] that reinforcement learning uses.
        task: Task that it acts in, set by the caller; empty if unknown.
        n_obs_steps: Observations, the newest last, that one call looks at.
        n_action_steps: Actions that one call returns.
        batch_invariant: Whether the actions of a sample are bit-identical, whatever other samples
            it is called with.
    """

    name: ClassVar[str]
    actions_of: ClassVar[Literal["task", "rl"]]
    task: str
    batch_invariant: bool

    @property
    def n_obs_steps(self) -> int:
        """See above."""
        ...

    @property
    def n_action_steps(self) -> int:
        """See above."""
        ...

    def act(
        self, observation: Observation, generators: "Sequence[torch.Generator] | None" = None
    ) -> "np.ndarray":
        """Chooses the next actions of ``n`` environments.

        Args:
            observation: ``observation.state`` (n, state_dim) float32 and ``observation.images.<camera>``
                (n, H, W, 3) uint8; with ``n_obs_steps`` above 1 each has a time axis after the first.
                ``task`` holds the instructions, a list of n strings. A policy ignores the
                keys that it does not use.
            generators: One CPU generator per environment, the source of all noise of that environment's
                sample. A deterministic policy ignores them.

        Returns:
            Actions (n, n_action_steps, action_dim), float32.

        Raises:
            PolicyError: if a key is absent or an array has another shape than the policy was made for.
        """
        ...

    def save(self, directory: str | Path) -> None:
        """Writes a checkpoint folder: all of it, or nothing."""
        ...

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> "Policy":
        """Reads a checkpoint folder.

        Raises:
            PolicyError: if a file is absent, damaged, or of another kind of policy.
        """
        ...
