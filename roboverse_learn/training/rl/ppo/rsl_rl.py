"""PPO by rsl_rl (arXiv:2109.11978): its algorithm and storage, all on the device."""

from typing import Any, override

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor, nn

from envs.adapters.rsl_rl import GROUP
from policies.ppo.network import PixelEncoder, RunningNorm
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.rl.ppo.algorithm import PpoAlgorithm

_GROUPS = {"actor": [GROUP], "critic": [GROUP]}


class BootstrappedPPO(PPO):
    """rsl_rl's PPO, which bootstraps an episode that is cut off by the value of its last observation.

    rsl_rl itself takes the value of the observation before the last step.
    """

    @override
    def process_env_step(
        self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: dict[str, Any]
    ) -> None:
        values = self.critic(extras["final_obs"]).detach().squeeze(-1)
        rewards = rewards + self.gamma * values * extras["time_outs"]
        super().process_env_step(obs, rewards, dones, {})


class _SeenOnce(nn.Module):
    """Features that actor and critic share: what is asked for again is not computed again.

    So a gradient step goes through the encoder of images once. What is kept is of the same tensor, and of
    weights and statistics that have not changed since.

    Args:
        features: Makes the features of an observation.
    """

    def __init__(self, features: RunningNorm | PixelEncoder) -> None:
        super().__init__()
        self.features = features
        self._kept: tuple[Any, Tensor] | None = None

    def forward(self, seen: Tensor) -> Tensor:
        tensors = [seen, *self.features.parameters(), *self.features.buffers()]
        now = (seen, torch.is_grad_enabled(), [tensor._version for tensor in tensors])
        if self._kept is None or self._kept[0][0] is not seen or self._kept[0][1:] != now[1:]:
            self._kept = (now, self.features(seen))
        return self._kept[1]

    def update(self, seen: Tensor) -> None:
        """Takes observations (n, D) into account."""
        self.features.update(seen)


class _Model(MLPModel):
    """rsl_rl's model, which takes the observation itself and no copy, so that :class:`_SeenOnce` knows it."""

    @override
    def get_latent(self, obs: TensorDict, masks: Any = None, hidden_state: Any = None) -> Tensor:
        return self.obs_normalizer(obs[GROUP])


class RslRlPpo(PpoAlgorithm):
    """See :class:`PpoAlgorithm`.

    Args:
        policy: An untrained policy.
        env: The env that it learns from.
        train: Optimization.
    """

    def __init__(self, policy: PpoPolicy, env: Any, train: TrainConfig) -> None:
        super().__init__(policy, train)
        config, device = self.config, str(policy.device)
        model = policy.model
        features: Any = model.norm
        blank = torch.zeros(env.num_envs, features.size_in, dtype=features.dtype_in, device=policy.device)
        obs, encoded = self._grouped(blank), self._grouped(torch.zeros(1, features.size))
        shape = {"hidden_dims": list(config.hidden_dims), "activation": config.activation}
        noise = {"class_name": "GaussianDistribution", "std_type": "log", "init_std": config.init_std}
        of_pixels = config.observation == "pixels"
        made = _Model if of_pixels else MLPModel
        actor: Any = made(encoded, _GROUPS, "actor", env.action_size, distribution_cfg=noise, **shape).to(
            device
        )
        critic: Any = made(encoded, _GROUPS, "critic", 1, **shape).to(device)
        # Both models are made of the policy's own tensors.
        actor.mlp, critic.mlp = model.layers, self.critic
        actor.distribution.log_std_param = model.log_std
        actor.obs_normalization = True
        storage = RolloutStorage("rl", env.num_envs, config.num_steps, obs, [env.action_size], device)
        self.ppo = BootstrappedPPO(
            actor,
            critic,
            storage,
            num_learning_epochs=config.num_epochs,
            num_mini_batches=config.num_minibatches,
            clip_param=config.clip,
            gamma=config.gamma,
            lam=config.lam,
            value_loss_coef=config.value_coef,
            entropy_coef=config.entropy_coef,
            learning_rate=train.lr,
            max_grad_norm=train.grad_clip or float("inf"),
            use_clipped_value_loss=False,
            schedule="adaptive" if config.schedule == "adaptive" else "fixed",  # linear is PpoAlgorithm's
            desired_kl=config.desired_kl,
            device=device,
        )
        self.ppo.optimizer = self.optimizer
        # They share the features of what is seen; afterwards, since its own optimizer takes no tensor twice.
        actor.obs_normalizer = critic.obs_normalizer = _SeenOnce(features) if of_pixels else features

    def _grouped(self, obs: Tensor) -> TensorDict:
        return TensorDict({GROUP: obs}, batch_size=[len(obs)], device=obs.device)

    @override
    @torch.no_grad()
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        return self.ppo.act(self._grouped(observation))

    @override
    @torch.no_grad()
    def keep(self, observation: Tensor, action: Tensor, step: Any) -> None:
        self._last = self._grouped(step.obs)
        extras = {"time_outs": step.truncated, "final_obs": self._grouped(step.final_obs)}
        self.ppo.process_env_step(self._last, step.reward, step.terminated | step.truncated, extras)

    @override
    def update(self) -> dict[str, float]:
        with torch.no_grad():
            self.ppo.compute_returns(self._last)
        self.ppo.learning_rate = self.lr
        terms = self.ppo.update()
        self.lr = self.ppo.learning_rate
        loss = terms["surrogate"] + self.config.value_coef * terms["value"]
        return {
            "loss": loss - self.config.entropy_coef * terms["entropy"],
            "policy_loss": terms["surrogate"],
            "value_loss": terms["value"],
            "entropy": terms["entropy"],
        }
