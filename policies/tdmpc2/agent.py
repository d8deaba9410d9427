"""TD-MPC2 while it gathers experience: many environments, warm start, exploration."""

from typing import Any

import torch
from torch import Tensor

from policies.compilation import compiled
from policies.cuda_graphs import Recorded
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import improved, plan, shifted
from policies.tdmpc2.world_model import WorldModel


class Tdmpc2Agent:
    """Acts in N environments, and remembers the last plan of each.

    Args:
        config: Settings of planning.
        model: The world model.
        discount: Discount of the task; (N, 1) where there are several.
        num_envs: N.
        task: Index of each environment's task (N,), or None where there is one alone.
        compile: Compile an iteration of the search.
        cuda_graphs: Record planning as a CUDA graph.
    """

    def __init__(
        self,
        config: Tdmpc2Config,
        model: WorldModel,
        discount: Tensor | float,
        num_envs: int,
        task: Tensor | None = None,
        *,
        compile: bool = False,
        cuda_graphs: bool = False,
    ) -> None:
        self.config, self.model, self.discount, self.task = config, model, discount, task
        self.device = model.action_masks.device
        self.mean = torch.zeros(num_envs, config.horizon, model.action_size, device=self.device)
        self._improve: Any = compiled(improved) if compile else improved
        self._plan: Any = self.plan
        if cuda_graphs:
            self._plan = Recorded(self.plan)

    @torch.no_grad()
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        """Chooses actions (N, A), with noise to explore.

        Args:
            observation: (N, D) or (N, C, 64, 64).
            first: Whether an episode has just begun, (N,) bool.
        """
        if not self.config.plan:
            z = self.model.encode(observation, self.task)
            return self.model.prior(z, torch.randn_like(self.mean[:, 0]), self.task).action
        action, mean = self._plan(observation, self.mean, first)
        self.mean.copy_(mean)
        return action

    def plan(self, observation: Tensor, mean: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """Returns actions with noise (N, A), and the means of the plans (N, H, A).

        Args:
            observation: See :meth:`act`.
            mean: Means of the last plans (N, H, A).
            first: See :meth:`act`.
        """
        planned = plan(
            self.config,
            self.model,
            self.model.encode(observation, self.task),
            shifted(mean, first),
            self.discount,
            self._normal,
            None if self.task is None else self.task[:, None],
            members=self.model.random_pair(),
            improve=self._improve,
        )
        action = planned.action + planned.std * torch.randn_like(planned.std)
        return action.clamp(-1.0, 1.0), planned.mean

    def _normal(self, *shape: int) -> Tensor:
        return torch.randn(*shape, device=self.device)
