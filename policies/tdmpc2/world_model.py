"""The networks of TD-MPC2: encoder, latent dynamics, reward, end of episode, policy prior, and values.

Shapes: ... leading axes of states and actions; a ``task`` is an int64 index that broadcasts to them, and
None where there is one task alone. D size of an observation, A of an action, L of the latent state.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.layers import PIXELS, PixelEncoder, QEnsemble, SimNorm, initialize, mlp
from policies.tdmpc2.two_hot import TwoHot

_LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
_SQUASH_EPS = 1e-6


class PriorSample(NamedTuple):
    """Actions of the policy prior.

    Attributes:
        action: Sampled actions (..., A), in [-1, 1].
        mean: The mean before sampling, squashed (..., A).
        entropy: One-sample estimate of the entropy (...), scaled by the number of action dimensions as in
            the authors' code.
    """

    action: Tensor
    mean: Tensor
    entropy: Tensor


class WorldModel(nn.Module):
    """An implicit world model (arXiv:2310.16828, section 3.1).

    Args:
        config: Sizes.
        observation_shape: (D,), or (C, 64, 64) for images.
        action_sizes: Size of an action of each task. Observations and actions of smaller tasks are padded
            with zeros to those of the largest one.

    Raises:
        PolicyError: if a shape is none that it can encode.
    """

    action_masks: Tensor

    def __init__(
        self, config: Tdmpc2Config, observation_shape: Sequence[int], action_sizes: Sequence[int]
    ) -> None:
        super().__init__()
        size, self.config = config.architecture, config
        self.action_size, self.num_tasks = max(action_sizes), len(action_sizes)
        task_dim = config.task_dim if self.num_tasks > 1 else 0
        latent, hidden = size.latent_dim, [size.mlp_dim] * 2
        masks = torch.arange(self.action_size) < torch.tensor(action_sizes)[:, None]
        self.register_buffer("action_masks", masks.float(), persistent=False)
        self.task_embedding = nn.Embedding(self.num_tasks, task_dim) if task_dim else None
        self.encoder = _encoder(config, tuple(observation_shape), task_dim)
        self.dynamics = mlp(
            latent + task_dim + self.action_size, hidden, latent, activation=SimNorm(config.simnorm_dim)
        )
        self.reward_head = mlp(latent + task_dim + self.action_size, hidden, config.num_bins)
        self.termination_head = mlp(latent + task_dim, hidden, 1) if config.episodic else None
        self.prior_head = mlp(latent + task_dim, hidden, 2 * self.action_size)
        self.apply(initialize)
        cast(nn.Linear, self.reward_head[-1]).weight.data.zero_()
        self.q = QEnsemble(
            size.num_q, latent + task_dim + self.action_size, size.mlp_dim, config.num_bins, config.dropout
        )
        self.target_q = QEnsemble(
            size.num_q, latent + task_dim + self.action_size, size.mlp_dim, config.num_bins, 0.0
        )
        self.target_q.load_state_dict(self.q.state_dict())
        self.target_q.requires_grad_(False)
        self.two_hot = TwoHot(config.num_bins, config.symlog_limit)

    # --- the model of the world -----------------------------------------------------------------

    def encode(self, observation: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns latent states (..., L) of observations (..., D) or (..., C, 64, 64)."""
        if isinstance(self.encoder, PixelEncoder):
            return self.encoder(observation)
        return self.encoder(self._with_task(observation, task))

    def next(self, z: Tensor, action: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns the latent states (..., L) that actions lead to."""
        return self.dynamics(self._joined(z, action, task))

    def reward_logits(self, z: Tensor, action: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns the rewards of actions as logits (..., num_bins)."""
        return self.reward_head(self._joined(z, action, task))

    def reward(self, z: Tensor, action: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns the rewards of actions (...)."""
        return self.two_hot.decode(self.reward_logits(z, action, task))

    def termination_logits(self, z: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns how likely it is that the episode ended in these states, as logits (...)."""
        assert self.termination_head is not None
        return self.termination_head(self._with_task(z, task)).squeeze(-1)

    def ended(self, z: Tensor, task: Tensor | None = None) -> Tensor:
        """Returns 1 where the episode has rather ended than not, else 0 (...)."""
        if self.termination_head is None:
            return torch.zeros_like(z[..., 0])
        return (self.termination_logits(z, task) > 0.0).to(z.dtype)

    # --- behaviour ------------------------------------------------------------------------------

    def prior(self, z: Tensor, noise: Tensor, task: Tensor | None = None) -> PriorSample:
        """Samples the policy prior.

        Args:
            z: Latent states (..., L).
            noise: Standard normal numbers (..., A).
            task: See the module.
        """
        config = self.config
        mean, log_std = self.prior_head(self._with_task(z, task)).chunk(2, dim=-1)
        span = config.log_std_max - config.log_std_min
        log_std = config.log_std_min + 0.5 * span * (torch.tanh(log_std) + 1.0)
        size: Tensor | int = self.action_size
        mask = self.action_mask(task)
        if mask is not None:
            mean, log_std, noise, size = mean * mask, log_std * mask, noise * mask, mask.sum(-1)
        gaussian = ((-0.5 * noise.square() - log_std).sum(-1) - _LOG_SQRT_2PI) * size
        action = torch.tanh(mean + noise * log_std.exp())
        squash = torch.log((1.0 - action.square()).clamp(min=0.0) + _SQUASH_EPS).sum(-1)
        return PriorSample(action, torch.tanh(mean), squash - gaussian)

    def action_mask(self, task: Tensor | None) -> Tensor | None:
        """Returns 1 for the action entries that a task has and 0 for its padding, (..., A)."""
        return None if task is None else self.action_masks[task]

    # --- values ---------------------------------------------------------------------------------

    def q_logits(
        self,
        z: Tensor,
        action: Tensor,
        task: Tensor | None = None,
        *,
        members: Tensor | None = None,
        target: bool = False,
        detached: bool = False,
    ) -> Tensor:
        """Returns values of actions as logits (K, ..., num_bins) of K members; None is all of them."""
        ensemble = self.target_q if target else self.q
        return ensemble(self._joined(z, action, task), members, detached=detached)

    def values(
        self, z: Tensor, action: Tensor, task: Tensor | None = None, *, members: Tensor | None = None
    ) -> Tensor:
        """Returns values of actions (...), the mean of the members."""
        return self.two_hot.decode(self.q_logits(z, action, task, members=members)).mean(0)

    def random_pair(self) -> Tensor:
        """Returns two different members of the ensemble, (2,) int64, without waiting for a GPU."""
        return torch.rand(self.q.num_q, device=self.action_masks.device).topk(2).indices

    @torch.no_grad()
    def update_target(self) -> None:
        """Moves the target ensemble towards the present one: target = (1 - tau) target + tau present."""
        pairs = zip(self.target_q.parameters(), self.q.parameters(), strict=True)
        for target, present in pairs:
            target.lerp_(present, self.config.tau)

    # --- conditioning ---------------------------------------------------------------------------

    def _with_task(self, x: Tensor, task: Tensor | None) -> Tensor:
        """Appends the embedding of the task, whose norm is at most 1."""
        if self.task_embedding is None:
            return x
        if task is None:
            raise PolicyError(f"This TD-MPC2 has {self.num_tasks} tasks: say which, as an index tensor.")
        embedding = self.task_embedding(task)
        embedding = embedding / embedding.norm(dim=-1, keepdim=True).clamp(min=1.0)
        return torch.cat([x, embedding.expand(*x.shape[:-1], -1)], dim=-1)

    def _joined(self, z: Tensor, action: Tensor, task: Tensor | None) -> Tensor:
        return torch.cat([self._with_task(z, task), action], dim=-1)


def _encoder(config: Tdmpc2Config, shape: tuple[int, ...], task_dim: int) -> nn.Module:
    size = config.architecture
    if len(shape) == 1:
        hidden = [size.enc_dim] * max(size.num_enc_layers - 1, 1)
        return mlp(shape[0] + task_dim, hidden, size.latent_dim, activation=SimNorm(config.simnorm_dim))
    if len(shape) == 3 and shape[1:] == (PIXELS, PIXELS):
        return PixelEncoder(shape[0], config.num_channels, size.latent_dim, config.simnorm_dim)
    raise PolicyError(
        f"TD-MPC2 encodes vectors (D,) and images (C, {PIXELS}, {PIXELS}); given the shape {shape}. "
        f"Observe the state, or take image_size={PIXELS}."
    )
