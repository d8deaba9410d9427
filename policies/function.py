"""Any function of observations as a policy, for an evaluation."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from envs.core.errors import PolicyError
from policies.base import Observation

if TYPE_CHECKING:
    import torch


class FunctionPolicy:
    """A function that chooses actions; it cannot be saved. See :class:`policies.base.Policy`.

    Args:
        function: Takes the observations of n environments (see :meth:`policies.base.Policy.act`) and returns
            their actions (n, action_dim), or chunks of them (n, T, action_dim), always of one T.
        actions_of: What the actions mean: ``task`` for the task's controller, ``rl`` for that of
            reinforcement learning.
    """

    name: ClassVar[str] = "function"
    task: str = ""
    n_obs_steps = 1
    batch_invariant = False

    def __init__(
        self, function: Callable[[Observation], np.ndarray], actions_of: Literal["task", "rl"] = "task"
    ) -> None:
        self.actions_of, self.n_action_steps = actions_of, 1
        self._function = function

    def act(
        self, observation: Observation, generators: "Sequence[torch.Generator] | None" = None
    ) -> np.ndarray:
        """Chooses the next actions of n environments, (n, T, action_dim) float32.

        Raises:
            PolicyError: The function returned an array of other axes.
        """
        del generators
        actions = np.asarray(self._function(observation), np.float32)
        if actions.ndim not in (2, 3):
            raise PolicyError(
                f"The policy returned an array of shape {actions.shape}. Return actions (n, action_dim) for "
                "n environments, or chunks of them (n, T, action_dim)."
            )
        chunks = actions if actions.ndim == 3 else actions[:, None]
        self.n_action_steps = chunks.shape[1]
        return chunks
