"""PPO by TorchRL: its loss, advantage estimate and actor modules."""

from typing import Any, override

import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, TensorDictModule
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from policies.ppo.network import Actor
from policies.ppo.policy import PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.rl.ppo.algorithm import PpoAlgorithm

_TERMS = {"loss_objective": "policy_loss", "loss_critic": "value_loss", "entropy": "entropy"}


class _Gaussian(nn.Module):
    """Mean and standard deviation of the policy's actions."""

    def __init__(self, model: Actor) -> None:
        super().__init__()
        self.model = model

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        mean = self.model(seen)
        return mean, self.model.log_std.exp().expand_as(mean)


class TorchRlPpo(PpoAlgorithm):
    """See :class:`PpoAlgorithm`.

    Args:
        policy: An untrained policy.
        env: The env that it learns from.
        train: Optimization.
    """

    def __init__(self, policy: PpoPolicy, env: Any, train: TrainConfig) -> None:
        super().__init__(policy, train)
        config = self.config
        gaussian = TensorDictModule(_Gaussian(policy.model), ["observation"], ["loc", "scale"])
        self.actor = ProbabilisticActor(
            gaussian,
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
            default_interaction_type=InteractionType.RANDOM,
        )
        value = ValueOperator(nn.Sequential(policy.model.norm, self.critic), ["observation"])
        self.gae = GAE(
            gamma=config.gamma,
            lmbda=config.lam,
            value_network=value,
            average_gae=True,
            deactivate_vmap=config.observation == "pixels",  # vmap cannot read bytes as floats
        )
        self.loss = ClipPPOLoss(
            self.actor,
            value,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy_coef,
            critic_coeff=config.value_coef,
            loss_critic_type="l2",
            normalize_advantage=False,
        )
        self._steps: list[Any] = []

    @override
    @torch.no_grad()
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        self._present: Any = self.actor(
            TensorDict({"observation": observation}, batch_size=[len(observation)])
        )
        return self._present["action"]

    @override
    def keep(self, observation: Tensor, action: Tensor, step: Any) -> None:
        columns = {
            "observation": step.final_obs,
            "reward": step.reward[:, None],
            "terminated": step.terminated[:, None],
            "done": (step.terminated | step.truncated)[:, None],
        }
        self._present["next"] = TensorDict(columns, batch_size=self._present.batch_size)
        self._steps.append(self._present)

    @override
    def update(self) -> dict[str, float]:
        config = self.config
        rollout: Any = torch.stack(self._steps, dim=1)
        self._steps.clear()
        with torch.no_grad():
            rollout = self.gae(rollout).reshape(-1)
        sums = dict.fromkeys((*_TERMS, "loss"), torch.zeros((), device=self.policy.device))
        for _ in range(config.num_epochs):
            order = torch.randperm(len(rollout), device=self.policy.device)
            for rows in order.chunk(config.num_minibatches):
                terms = self.loss(rollout[rows])
                loss = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                self.optimizer.zero_grad()
                loss.backward()
                if self.train.grad_clip:
                    nn.utils.clip_grad_norm_(self.parameters, self.train.grad_clip)
                self.optimizer.step()
                now = {"loss": loss.detach(), **{key: terms[key].detach() for key in _TERMS}}
                sums = {key: value + now[key] for key, value in sums.items()}
        moved = self.adapt(rollout["observation"], rollout["loc"], rollout["scale"])
        self.policy.model.norm.update(rollout["observation"])
        count = config.num_epochs * config.num_minibatches
        means = {_TERMS.get(key, key): float(value) / count for key, value in sums.items()}
        means["value_loss"] /= config.value_coef
        return means | {"kl": moved}
