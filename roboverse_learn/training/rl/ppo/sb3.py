"""PPO by Stable-Baselines3: its policy, rollout buffer and update; rollouts are kept on the host."""

import contextlib
from collections.abc import Iterator
from typing import Any, override

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor

from envs.adapters.sb3 import Sb3VecEnv
from policies.ppo.network import ACTIVATIONS, RunningNorm
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.rl.ppo.algorithm import PpoAlgorithm


class _Normalized(BaseFeaturesExtractor):
    """Features that are the observation, normalized."""

    def __init__(self, observation_space: Any, norm: RunningNorm) -> None:
        super().__init__(observation_space, observation_space.shape[0])
        self.norm = norm

    @override
    def forward(self, observations: Tensor) -> Tensor:
        return self.norm(observations)


class Sb3Ppo(PpoAlgorithm):
    """See :class:`PpoAlgorithm`.

    Args:
        policy: An untrained policy.
        env: The env that it learns from.
        train: Optimization.
    """

    def __init__(self, policy: PpoPolicy, env: Any, train: TrainConfig) -> None:
        super().__init__(policy, train)
        config = self.config
        widths = list(config.hidden_dims)
        self.ppo = PPO(
            "MlpPolicy",
            Sb3VecEnv(env),
            learning_rate=lambda _: self.lr,
            n_steps=config.num_steps,
            batch_size=config.rollout_size // config.num_minibatches,
            n_epochs=config.num_epochs,
            gamma=config.gamma,
            gae_lambda=config.lam,
            clip_range=config.clip,
            ent_coef=config.entropy_coef,
            vf_coef=config.value_coef,
            max_grad_norm=train.grad_clip or float("inf"),
            device=str(policy.device),
            policy_kwargs={
                "net_arch": {"pi": widths, "vf": widths},
                "activation_fn": ACTIVATIONS[config.activation],
                "features_extractor_class": _Normalized,
                "features_extractor_kwargs": {"norm": policy.model.norm},
            },
        )
        # Stable-Baselines3's policy is made of the policy's own tensors.
        theirs: Any = self.ppo.policy
        theirs.mlp_extractor.policy_net, theirs.action_net = policy.model.layers[:-1], policy.model.layers[-1]
        theirs.mlp_extractor.value_net, theirs.value_net = self.critic[:-1], self.critic[-1]
        theirs.log_std = policy.model.log_std
        theirs.optimizer = self.optimizer
        self.ppo.set_logger(Logger(folder=None, output_formats=[]))
        self._buffer: RolloutBuffer = self.ppo.rollout_buffer
        self._buffer.reset()

    @override
    @torch.no_grad()
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        if not bool(observation.isfinite().all()):  # their distribution would say so less clearly
            raise self.diverged("An observation is not finite")
        self._first = first.cpu().numpy()
        actions, self._values, self._log_probs = self.ppo.policy(observation)
        return actions

    @override
    @torch.no_grad()
    def keep(self, observation: Tensor, action: Tensor, step: Any) -> None:
        rewards = step.reward + self.config.gamma * self.values(step.final_obs)[:, 0] * step.truncated
        seen, taken, rewarded = (value.cpu().numpy() for value in (observation, action, rewards))
        self._buffer.add(seen, taken, rewarded, self._first, self._values, self._log_probs)
        self._last, self._over = step.obs, (step.terminated | step.truncated).cpu().numpy()

    @override
    def update(self) -> dict[str, float]:
        with torch.no_grad():
            self._buffer.compute_returns_and_advantage(self.values(self._last)[:, 0], self._over)
            seen = torch.as_tensor(np.concatenate(self._buffer.observations), device=self.policy.device)
            mean, std = self.policy.model(seen), self.policy.model.log_std.exp().clone()
        with _shuffled_by_torch():
            self.ppo.train()
        moved = self.adapt(seen, mean, std)
        self.policy.model.norm.update(seen)
        self._buffer.reset()
        logged = self.ppo.logger.name_to_value
        return {
            "loss": float(logged["train/loss"]),
            "policy_loss": float(logged["train/policy_gradient_loss"]),
            "value_loss": float(logged["train/value_loss"]),
            "entropy": -float(logged["train/entropy_loss"]),
            "kl": moved,
        }


@contextlib.contextmanager
def _shuffled_by_torch() -> Iterator[None]:
    """Seeds numpy's generator, which shuffles their buffer, from torch's, which the run seeds."""
    before = np.random.get_state()
    np.random.seed(int(torch.randint(2**31, ())))
    try:
        yield
    finally:
        np.random.set_state(before)
