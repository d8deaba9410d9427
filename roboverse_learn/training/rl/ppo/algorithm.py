"""Base of the backends: networks, optimizer, schedule of updates, state.

A backend trains the policy's own network, so that what is saved is the same whichever it is.

Shapes: N environments, T steps of a rollout, D entries of an observation, A of an action.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from policies.ppo.network import Actor, perceptron
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training import checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.divergence import TrainingDivergedError

MIN_LR, MAX_LR, LR_FACTOR = 1e-5, 1e-2, 1.5
"""The bounds and the factor of rsl_rl's adaptive learning rate."""

_ADAM_EPS = 1e-5
"""Engstrom et al. 2020 (arXiv:2005.12729), and Stable-Baselines3."""


class PpoAlgorithm(ABC):
    """PPO, as the loop in :mod:`roboverse_learn.training.rl.loop` drives it.

    Args:
        policy: An untrained policy, trained in place.
        train: Learning rate and largest norm of the gradient.

    Attributes:
        critic: Values of the features of observations, which are the actor's.
        parameters: All that is learned.
        optimizer: Adam.
    """

    def __init__(self, policy: PpoPolicy, train: TrainConfig) -> None:
        self.policy, self.config, self.train, own = policy, policy.config, train, policy.config
        self.batch_size = own.rollout_size
        self.settings: dict[str, Any] = {"backend": own.backend, "num_steps": own.num_steps}
        if own.observation == "pixels":
            self.settings |= {"observation": policy.sizes, "num_frames": own.num_frames}
        actor = policy.model
        self.critic = perceptron(actor.norm.size, self.config.hidden_dims, 1, self.config.activation).to(
            policy.device
        )
        initialize(actor, self.critic)
        self.parameters = [*actor.parameters(), *self.critic.parameters()]
        self.lr = train.lr
        self.optimizer = torch.optim.Adam(self.parameters, lr=self.lr, eps=_ADAM_EPS)
        self.collected, self.updates = 0, 0
        self._sound = torch.ones((), dtype=torch.bool, device=policy.device)

    @abstractmethod
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        """Draws actions (N, A) and remembers what an update needs of them."""

    @abstractmethod
    def keep(self, observation: Tensor, action: Tensor, step: Any) -> None:
        """Takes a step into the rollout; ``step`` is an :class:`~envs.torch_env.EnvStep`."""

    @abstractmethod
    def update(self) -> dict[str, float]:
        """Learns from the full rollout and clears it; returns the mean terms of the loss."""

    def store(self, observation: Tensor, action: Tensor, step: Any) -> None:
        """Stores the step that followed the actions."""
        self.keep(observation, action, step)
        self.collected += 1
        self._sound = self._sound & step.reward.isfinite().all() & step.obs.isfinite().all()

    def must_learn(self) -> bool:
        """Whether the rollout is full."""
        return self.collected >= self.config.num_steps

    def learn(self) -> Mapping[str, Tensor]:
        """Updates the policy by the rollout.

        Raises:
            TrainingDivergedError: if what was seen, a weight or a term of the loss is not finite.
        """
        self.collected = 0
        self.updates += 1
        if not bool(self._sound):
            raise self.diverged("A reward or an observation is not finite")
        try:
            terms = self.update()
        except (ValueError, RuntimeError) as error:  # a distribution with parameters that are not finite
            if "found invalid values" in str(error):
                raise self.diverged("An output of the policy is not finite") from error
            if all(bool(parameter.isfinite().all()) for parameter in self.parameters):
                raise
            raise self.diverged("A weight is not finite") from error
        wrong = [key for key, value in terms.items() if not math.isfinite(value)]
        if wrong:
            raise self.diverged(f"'{wrong[0]}' is {terms[wrong[0]]}")
        terms |= {"std": float(self.policy.model.log_std.detach().exp().mean()), "lr": self.lr}
        return {key: torch.tensor(value) for key, value in terms.items()}

    def diverged(self, what: str) -> TrainingDivergedError:
        """Makes the error of a run that is lost."""
        steps = self.updates * self.config.rollout_size
        return TrainingDivergedError(
            f"{what} at update {self.updates:,} of backend={self.config.backend}, at environment step "
            f"{steps:,}. Take a smaller train.lr or train.grad_clip, or look at the task's observations and "
            "rewards."
        )

    def values(self, observation: Tensor) -> Tensor:
        """Returns the values of observations (…, D), (…, 1)."""
        return self.critic(self.policy.model.norm(observation))

    @torch.no_grad()
    def adapt(self, observation: Tensor, mean: Tensor, std: Tensor) -> float:
        """Adapts the learning rate by how far the policy has moved; returns its mean KL divergence.

        Args:
            observation: The rollout's observations, (n, D).
            mean: Means of the old policy, (n, A).
            std: Its standard deviations, which broadcast with ``mean``.
        """
        new, scale = self.policy.model(observation), self.policy.model.log_std.exp()
        kl = (scale / std).log() + (std.square() + (mean - new).square()) / (2 * scale.square()) - 0.5
        moved = float(kl.sum(-1).mean())
        if self.config.schedule == "adaptive":
            if moved > 2.0 * self.config.desired_kl:
                self.lr = max(MIN_LR, self.lr / LR_FACTOR)
            elif 0.0 < moved < 0.5 * self.config.desired_kl:
                self.lr = min(MAX_LR, self.lr * LR_FACTOR)
            self._use_lr()
        return moved

    def set_progress(self, fraction: float) -> None:
        """Hears how much of the run is done, from 0 to 1, which ``schedule=linear`` follows."""
        if self.config.schedule == "linear":
            self.lr = self.train.lr * (1.0 - fraction)
            self._use_lr()

    def _use_lr(self) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self.lr

    def may_stop(self) -> bool:
        """Whether no rollout is under way, which a checkpoint would lose."""
        return self.collected == 0

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Returns the state that resuming after an update needs."""
        tensors = checkpoint.named(self.policy.state_dict(), "policy")
        tensors |= checkpoint.named(self.critic.state_dict(), "critic")
        tensors |= checkpoint.moments(self.optimizer, "adam")
        return tensors, {"lr": self.lr, "updates": self.updates}

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Takes back what :meth:`state` returned."""
        self.policy.model.load_state_dict(checkpoint.part(tensors, "policy"))
        self.critic.load_state_dict(checkpoint.part(tensors, "critic"))
        checkpoint.load_moments(self.optimizer, tensors, "adam")
        self.lr, self.updates = numbers["lr"], numbers["updates"]
        self._use_lr()


def initialize(actor: Actor, critic: nn.Sequential) -> None:
    """Draws orthogonal weights with the usual gains: √2, 0.01 of the mean action, 1 of the value."""
    for layers, last in ((actor.layers, 0.01), (critic, 1.0)):
        linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
        for layer in linear:
            nn.init.orthogonal_(layer.weight, last if layer is linear[-1] else math.sqrt(2.0))
            nn.init.zeros_(layer.bias)
