"""One step of learning of FastTD3.

Shapes: B samples, D observation, A action, K atoms; 2 is the two critics.
"""

import copy
from typing import Any

import torch
from torch import Tensor

from policies.compilation import compiled
from policies.cuda_graphs import Recorded
from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.networks import Actor, Critics, RunningNorm, project


class Updater:
    """Trains actor and critics (arXiv:2505.22642).

    TorchRL's ``TD3Loss`` has no distributional critic, which the method needs; so the loss is here.

    Args:
        config: Settings of learning.
        actor: What acts.
        critics: What values.
        norm: Normalization of the observations.
        compile: Compile both losses.
        cuda_graphs: Record an update as a CUDA graph after the first ones.
        bf16: Compute under autocast.
    """

    def __init__(
        self,
        config: FastTd3Config,
        actor: Actor,
        critics: Critics,
        norm: RunningNorm,
        *,
        compile: bool = False,
        cuda_graphs: bool = False,
        bf16: bool = False,
    ) -> None:
        self.config, self.actor, self.critics, self.norm = config, actor, critics, norm
        self.target = copy.deepcopy(critics).requires_grad_(False)
        self.device, self.bf16 = critics.atoms.device, bf16
        options: dict[str, Any] = {"fused": True, "capturable": self.device.type == "cuda"}
        options |= {"lr": config.lr, "weight_decay": config.weight_decay}
        self.critic_optimizer = torch.optim.AdamW(critics.parameters(), **options)
        self.actor_optimizer = torch.optim.AdamW(actor.parameters(), **options)
        self._critic_loss = compiled(self.critic_loss) if compile else self.critic_loss
        self._actor_loss = compiled(self.actor_loss) if compile else self.actor_loss
        record: Any = Recorded if cuda_graphs else lambda function: function
        self._both, self._critic = record(self.step), record(self.critic_step)
        self.updates = 0

    def update(self, *batch: Tensor) -> dict[str, Tensor]:
        """Learns from one batch; returns the terms of the losses, on the device.

        Args:
            batch: Observation (B, D), action (B, A), reward (B,), discount (B,) and next observation
                (B, D), as the env gave them; see :meth:`targets`.
        """
        self.updates += 1
        with_actor = self.updates % self.config.policy_frequency == 0
        return (self._both if with_actor else self._critic)(*batch)

    def critic_step(self, *batch: Tensor) -> dict[str, Tensor]:
        """Updates the critics and their target."""
        loss, terms = self._critic_loss(*batch)
        loss.backward()
        self.critic_optimizer.step()
        self.critic_optimizer.zero_grad(set_to_none=True)
        with torch.no_grad():
            for target, present in zip(self.target.parameters(), self.critics.parameters(), strict=True):
                target.lerp_(present, self.config.tau)
        return {key: value.detach() for key, value in terms.items()}

    def step(self, *batch: Tensor) -> dict[str, Tensor]:
        """Updates the critics and the actor."""
        terms = self.critic_step(*batch)
        loss = self._actor_loss(batch[0])
        loss.backward()
        self.actor_optimizer.step()
        self.actor_optimizer.zero_grad(set_to_none=True)
        return terms

    @torch.no_grad()
    def targets(self, reward: Tensor, discount: Tensor, next_seen: Tensor) -> Tensor:
        """Returns the distributions that the critics should have, (2, B, K).

        Args:
            reward: Discounted sum of the rewards of one step or of a few, (B,).
            discount: Weight of the next value (B,): 0 where the episode terminated, not where it was
                truncated.
            next_seen: Normalized observations after them (B, D).
        """
        config, atoms = self.config, self.critics.atoms
        action = self.actor(next_seen)
        noise = torch.randn_like(action) * config.target_noise
        noise = noise.clamp(-config.target_noise_clip, config.target_noise_clip)
        action = (action + noise).clamp(-1.0, 1.0)
        probabilities = torch.softmax(self.target(next_seen, action).float(), dim=-1)
        projected = project(probabilities, reward[:, None] + discount[:, None] * atoms, atoms)
        if not config.clipped_double:
            return projected
        value = self.critics.value(projected)  # (2, B)
        less = torch.where((value[0] < value[1])[:, None], projected[0], projected[1])
        return less.expand(2, -1, -1)

    def critic_loss(
        self,
        observation: Tensor,
        action: Tensor,
        reward: Tensor,
        discount: Tensor,
        next_observation: Tensor,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the cross-entropy of both critics with their targets, and terms.

        ``mass_at_limits`` is the share of the targets at ``v_min`` and ``v_max``: where it is not about 0,
        values do not fit between them.
        """
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            targets = self.targets(reward, discount, self.norm(next_observation))
            logits = self.critics(self.norm(observation), action)
        loss = -(targets * torch.log_softmax(logits.float(), dim=-1)).sum(-1).mean(1).sum(0)
        value = self.critics.value(targets)
        beyond = (targets[..., 0] + targets[..., -1]).mean()
        terms = {"loss": loss, "target_value": value.mean(), "target_value_max": value.max()}
        return loss, terms | {"mass_at_limits": beyond}

    def actor_loss(self, observation: Tensor) -> Tensor:
        """Returns minus the value of what the actor would do."""
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            seen = self.norm(observation)
            logits = self.critics(seen, self.actor(seen), detached=True)
        values = self.critics.value(torch.softmax(logits.float(), dim=-1))  # (2, B)
        return -(values.amin(0) if self.config.clipped_double else values.mean(0)).mean()
