"""One step of learning: the world model and its values, then the policy prior, then the target values.

Shapes: H steps of a sequence, B sequences, K members of the ensemble, L a latent state.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from policies.compilation import compiled
from policies.cuda_graphs import Recorded
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.scale import RunningScale
from policies.tdmpc2.world_model import WorldModel

_PRIOR_EPS = 1e-5


class Sequences(NamedTuple):
    """Pieces of episodes, time first.

    Attributes:
        observations: (H + 1, B, ...).
        actions: (H, B, A).
        rewards: (H, B).
        terminated: 1 where the episode ended by failure or success after the action, else 0, (H, B).
        valid: 1 up to the end of the episode, 0 after it: what is not learned from, (H, B).
        task: Index of each sequence's task (B,), or None.
    """

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    terminated: Tensor
    valid: Tensor
    task: Tensor | None = None


class Updater:
    """Trains a world model (arXiv:2310.16828, equations 3 and 4).

    The two losses are functions without a break in their graphs, and nothing in an update waits for a
    GPU, so both can be compiled and the whole update be recorded as one CUDA graph.

    Args:
        config: Settings of learning.
        model: What learns; moved nowhere.
        discounts: Discount of each task.
        compile: Compile both losses.
        cuda_graphs: Record an update as a CUDA graph after the first ones.
    """

    def __init__(
        self,
        config: Tdmpc2Config,
        model: WorldModel,
        discounts: list[float],
        *,
        compile: bool = False,
        cuda_graphs: bool = False,
    ) -> None:
        self.config, self.model = config, model
        device = model.action_masks.device
        self.scale = RunningScale(config.tau).to(device)
        self.discounts = torch.tensor(discounts, device=device)
        self.weights = config.rho ** torch.arange(config.horizon + 1.0, device=device)
        self._prior_parameters = list(model.prior_head.parameters())
        encoder = list(model.encoder.parameters())
        others = {id(parameter) for parameter in encoder + self._prior_parameters}
        rest = [p for p in model.parameters() if p.requires_grad and id(p) not in others]
        self._world_parameters = encoder + rest
        options: dict[str, Any] = {"fused": True, "capturable": device.type == "cuda"}
        groups = [{"params": encoder, "lr": config.lr * config.enc_lr_scale}, {"params": rest}]
        self.optimizer = torch.optim.Adam(groups, config.lr, **options)
        self.prior_optimizer = torch.optim.Adam(self._prior_parameters, config.lr, eps=_PRIOR_EPS, **options)
        self._world_loss = compiled(self.world_loss) if compile else self.world_loss
        self._prior_loss = compiled(self.prior_loss) if compile else self.prior_loss
        self._step: Any = self.step
        if cuda_graphs:
            self._step = Recorded(self.step)

    def update(self, batch: Sequences) -> dict[str, Tensor]:
        """Learns from one batch; returns the terms of both losses, on the device."""
        self.model.train()
        metrics = self._step(*(field for field in batch if field is not None))
        self.model.eval()
        return metrics

    def step(self, *fields: Tensor) -> dict[str, Tensor]:
        """The update itself, of the fields of a :class:`Sequences`."""
        batch = Sequences(*fields)
        loss, zs, metrics = self._world_loss(batch)
        loss.backward()
        clip = self.config.grad_clip_norm
        norm = torch.nn.utils.clip_grad_norm_(self._world_parameters, clip)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        prior_loss, prior_metrics = self._prior_loss(zs, batch)
        # Nothing else: the embedding of tasks would keep a gradient of the prior for the next update.
        prior_loss.backward(inputs=self._prior_parameters)
        prior_norm = torch.nn.utils.clip_grad_norm_(self._prior_parameters, clip)
        self.prior_optimizer.step()
        self.prior_optimizer.zero_grad(set_to_none=True)
        self.model.update_target()
        norms = {"grad_norm": norm, "prior_grad_norm": prior_norm}
        return {key: value.detach() for key, value in (metrics | prior_metrics | norms).items()}

    def targets(self, next_z: Tensor, batch: Sequences) -> Tensor:
        """Returns what values should be (H, B): reward, and the lesser of two target values after it.

        Args:
            next_z: Latent states after each action (H, B, L).
            batch: The sequences.
        """
        model = self.model
        action = model.prior(next_z, torch.randn_like(batch.actions), batch.task).action
        logits = model.q_logits(next_z, action, batch.task, members=model.random_pair(), target=True)
        values = model.two_hot.decode(logits).amin(0)
        goes_on = 1.0 - batch.terminated if self.config.episodic else 1.0
        return batch.rewards + self._discount(batch.task) * goes_on * values

    def world_loss(self, batch: Sequences) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Returns the loss of the world model and the values, the latent rollout (H + 1, B, L), and terms."""
        config, model, task, valid = self.config, self.model, batch.task, batch.valid
        with torch.no_grad():
            next_z = model.encode(batch.observations[1:], task)
            targets = self.targets(next_z, batch)
        zs = self._rollout(batch)
        weights = self.weights[:-1]
        apart = functional.mse_loss(zs[1:], next_z, reduction="none").mean(2)
        consistency = ((apart * valid).mean(1) * weights).mean()
        rewards = model.reward_logits(zs[:-1], batch.actions, task)
        reward = ((model.two_hot.loss(rewards, batch.rewards) * valid).mean(1) * weights).mean()
        q = model.q_logits(zs[:-1], batch.actions, task)
        value = ((model.two_hot.loss(q, targets) * valid).mean((0, 2)) * weights).mean()
        terms = {"consistency_loss": consistency, "reward_loss": reward, "value_loss": value}
        loss = config.consistency_coef * consistency + config.reward_coef * reward + config.value_coef * value
        if config.episodic:
            logits = model.termination_logits(zs[1:], task)
            ended = functional.binary_cross_entropy_with_logits(logits, batch.terminated, weight=valid)
            terms["termination_loss"] = ended
            loss = loss + config.termination_coef * terms["termination_loss"]
        return loss, zs.detach(), terms | {"loss": loss, "target_value": targets.mean()}

    def _rollout(self, batch: Sequences) -> Tensor:
        """Returns the first latent state and those that the actions lead to, (H + 1, B, L)."""
        states = [self.model.encode(batch.observations[0], batch.task)]
        for action in batch.actions.unbind(0):
            states.append(self.model.next(states[-1], action, batch.task))
        return torch.stack(states)

    def prior_loss(self, zs: Tensor, batch: Sequences) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the loss of the policy prior on latent states (H + 1, B, L), and its terms."""
        model, task = self.model, batch.task
        valid = torch.cat([torch.ones_like(batch.valid[:1]), batch.valid])
        noise = torch.randn(*zs.shape[:-1], model.action_size, device=zs.device)
        sample = model.prior(zs, noise, task)
        logits = model.q_logits(zs, sample.action, task, members=model.random_pair(), detached=True)
        values = model.two_hot.decode(logits).mean(0)
        self.scale.update(values[0].detach())
        gain = self.config.entropy_coef * sample.entropy + self.scale(values)
        loss = -((gain * valid).mean(1) * self.weights).mean()
        terms = {"prior_loss": loss, "prior_entropy": sample.entropy.mean(), "value_scale": self.scale.value}
        return loss, terms

    def _discount(self, task: Tensor | None) -> Tensor:
        return self.discounts[0] if task is None else self.discounts[task]
