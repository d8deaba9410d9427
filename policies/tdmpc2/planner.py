"""Model predictive path integral control in latent space, for many environments at once.

Shapes: N environments, H steps of the horizon, S action sequences, P of them of the policy prior,
E elites, A size of an action.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from policies.tdmpc2.config import Tdmpc2Config

Normal = Callable[..., Tensor]
"""Draws standard normal numbers of a shape, whose first axis is N."""


class PlanningModel(Protocol):
    """World model that the planner needs, such as :class:`~policies.tdmpc2.world_model.WorldModel`."""

    def next(self, z: Tensor, action: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns the states that actions lead to."""
        ...

    def reward(self, z: Tensor, action: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns the rewards of actions (...)."""
        ...

    def ended(self, z: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns 1 where the episode is over, else 0 (...)."""
        ...

    def prior(self, z: Tensor, noise: Tensor, task: Tensor | None = None) -> "tuple[Tensor, Tensor, Tensor]":
        """Returns actions of the policy prior, their mean and an entropy."""
        ...

    def values(
        self, z: Tensor, action: Tensor, task: Tensor | None = None, *, members: Tensor | None = None
    ) -> Tensor:
        """Returns the value after the horizon (...)."""
        ...

    def action_mask(self, task: Tensor | None) -> Tensor | None:
        """Returns which action entries a task has, or None for all."""
        ...


class Plan(NamedTuple):
    """Result of planning.

    Attributes:
        action: Action to take (N, A): the first one of a sequence sampled from the elites.
        mean: Mean of the elites (N, H, A), which the next plan starts from.
        std: Their deviation at the first step (N, A), the noise to explore with.
    """

    action: Tensor
    mean: Tensor
    std: Tensor


def shifted(mean: Tensor, first: Tensor) -> Tensor:
    """Returns where the next plan starts: the last mean one step later, and zeros where it has none.

    Args:
        mean: Mean of the last plan (N, H, A).
        first: Whether an episode has just begun, (N,) bool.
    """
    later = torch.cat([mean[:, 1:], torch.zeros_like(mean[:, :1])], dim=1)
    return torch.where(first[:, None, None], 0.0, later)


def prior_rollout(
    model: PlanningModel, z: Tensor, noise: Tensor, task: Tensor | None = None, *, mean: bool = False
) -> Tensor:
    """Returns what the policy prior would do: actions (N, H, P, A).

    Args:
        model: The model of the world.
        z: Latent states (N, L).
        noise: Standard normal numbers (N, H, P, A).
        task: Index of each environment's task (N, 1), or None.
        mean: Take its mean action at every step, not a sample.
    """
    z = z[:, None].expand(-1, noise.shape[2], -1)
    actions = []
    for step in range(noise.shape[1]):
        sample = model.prior(z, noise[:, step], task)
        actions.append(sample[1] if mean else sample[0])
        if step + 1 < noise.shape[1]:
            z = model.next(z, actions[-1], task)
    return torch.stack(actions, dim=1)


def estimate_value(
    model: PlanningModel,
    z: Tensor,
    actions: Tensor,
    noise: Tensor,
    discount: Tensor | float,
    task: Tensor | None = None,
    members: Tensor | None = None,
) -> Tensor:
    """Returns the discounted reward of action sequences and of what follows them (N, S).

    Args:
        model: The model of the world.
        z: Latent states (N, L).
        actions: Action sequences (N, H, S, A).
        noise: Standard normal numbers (N, S, A), for the action after the last.
        discount: Discount per step; (N, 1) where tasks differ.
        task: Index of each environment's task (N, 1), or None.
        members: Members of the Q ensemble that the rest is valued by; None is all.
    """
    z = z[:, None].expand(-1, actions.shape[2], -1)
    total, weight = torch.zeros_like(actions[:, 0, :, 0]), torch.ones_like(actions[:, 0, :, 0])
    for action in actions.unbind(1):
        total = total + weight * model.reward(z, action, task)
        z = model.next(z, action, task)
        weight = weight * discount * (1.0 - model.ended(z, task))
    last, _, _ = model.prior(z, noise, task)
    return total + weight * model.values(z, last, task, members=members)


class Search(NamedTuple):
    """State of the search for a plan.

    Attributes:
        mean: Mean of the elites (N, H, A).
        std: Their deviation (N, H, A).
        first: First actions of the elites (N, E, A).
        weights: Their weights (N, E), which sum to 1.
    """

    mean: Tensor
    std: Tensor
    first: Tensor
    weights: Tensor


def improved(
    config: Tdmpc2Config,
    model: PlanningModel,
    z: Tensor,
    of_prior: Tensor,
    mean: Tensor,
    std: Tensor,
    discount: Tensor | float,
    normal: Normal,
    task: Tensor | None = None,
    members: Tensor | None = None,
) -> Search:
    """One iteration of the search: samples sequences, and keeps the best; see :func:`plan`.

    Args:
        config: Settings of planning.
        model: The model of the world.
        z: Latent states (N, L).
        of_prior: What the policy prior would do (N, H, P, A).
        mean: Mean to sample about (N, H, A).
        std: Deviation to sample with (N, H, A).
        discount: Discount per step; (N, 1) where tasks differ.
        normal: Noise source.
        task: Index of each environment's task (N, 1), or None.
        members: Members of the Q ensemble to value by; None is all.
    """
    num_envs, horizon, size = mean.shape
    noise = normal(num_envs, horizon, config.num_samples - config.num_pi_trajs, size)
    sampled = (mean[:, :, None] + std[:, :, None] * noise).clamp(-1.0, 1.0)
    actions = torch.cat([of_prior, sampled], dim=2)
    mask = model.action_mask(task)  # (N, 1, A)
    if mask is not None:
        actions = actions * mask[:, :, None]
    after = normal(num_envs, config.num_samples, size)
    value = estimate_value(model, z, actions, after, discount, task, members).nan_to_num(0.0)
    best = value.topk(config.num_elites, dim=1)  # (N, E)
    index = best.indices[:, None, :, None].expand(-1, horizon, -1, size)
    elites = actions.gather(2, index)  # (N, H, E, A)
    weights = torch.softmax(config.temperature * best.values, dim=1)
    share = weights[:, None, :, None]
    mean = (share * elites).sum(2)
    std = (share * (elites - mean[:, :, None]).square()).sum(2).sqrt().clamp(config.min_std, config.max_std)
    if mask is not None:
        mean, std = mean * mask, std * mask
    return Search(mean, std, elites[:, 0], weights)


def plan(
    config: Tdmpc2Config,
    model: PlanningModel,
    z: Tensor,
    mean: Tensor,
    discount: Tensor | float,
    normal: Normal,
    task: Tensor | None = None,
    members: Tensor | None = None,
    *,
    improve: Callable[..., Search] = improved,
) -> Plan:
    """Plans an action for every environment (arXiv:2310.16828, section 3.3; arXiv:2203.04955, algorithm 1).

    Args:
        config: Settings of planning.
        model: The model of the world.
        z: Latent states (N, L).
        mean: Where the search starts (N, H, A); see :func:`shifted`.
        discount: Discount per step; (N, 1) where tasks differ.
        normal: Noise source.
        task: Index of each environment's task (N, 1), or None.
        members: Members of the Q ensemble to value by; None is all.
        improve: :func:`improved`, or what the compiler made of it.
    """
    num_envs, horizon, size = mean.shape
    noise = normal(num_envs, horizon, config.num_pi_trajs, size)
    of_prior = prior_rollout(model, z, noise, task)
    search = Search(mean, torch.full_like(mean, config.max_std), mean, mean)
    for _ in range(config.planning_iterations(size)):
        search = improve(config, model, z, of_prior, search.mean, search.std, discount, normal, task, members)
    return Plan(_drawn(search.first, search.weights, normal), search.mean, search.std[:, 0])


def _drawn(actions: Tensor, weights: Tensor, normal: Normal) -> Tensor:
    """Draws one action (N, A) of (N, E, A) by its weight (N, E), by the Gumbel-max trick."""
    # A uniform number from a normal one: the same source serves, and nothing waits for a GPU.
    uniform = (0.5 * torch.erfc(-normal(*weights.shape) / 2.0**0.5)).clamp(1e-7, 1.0 - 1e-7)
    chosen = (weights.log() - (-uniform.log()).log()).argmax(dim=1)
    return actions.gather(1, chosen[:, None, None].expand(-1, 1, actions.shape[-1])).squeeze(1)
