"""FastTD3 in many environments at once: a few large updates after each step of all of them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, override

import torch
from torch import Tensor

from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.policy import FastTd3Policy
from policies.fasttd3.update import Updater
from roboverse_learn.training import checkpoint
from roboverse_learn.training.learners import AgentLearner
from roboverse_learn.training.rl import loop
from roboverse_learn.training.rl.environment import check_env, make_env
from roboverse_learn.training.rl.replay_buffer import ReplayBuffer, Transitions, check_room

_TIMED_BATCH, _TIMED_STEPS = 1024, 100


class FastTd3Algorithm:
    """FastTD3 (arXiv:2505.22642), as the loop in :mod:`roboverse_learn.training.rl.loop` has it.

    Args:
        policy: An untrained policy, trained in place.
        num_envs: Environments.
    """

    def __init__(self, policy: FastTd3Policy, num_envs: int) -> None:
        config, device = policy.config, policy.device
        self.policy, self.config, self.batch_size = policy, config, config.batch_size
        self.updater = Updater(
            config,
            policy.actor,
            policy.critics,
            policy.norm,
            compile=loop.wanted(config.compile, device),
            cuda_graphs=loop.wanted(config.cuda_graphs, device),
            bf16=loop.wanted(config.bf16, device),
        )
        size = sum(policy.sizes.values())
        self.buffer = ReplayBuffer(config.buffer_size, num_envs, size, policy.action_size, device)
        self.first_steps = max(1, config.learning_starts * num_envs)
        check_room(self.buffer, config.buffer_size, self.first_steps, "policy.learning_starts")
        self.due = 0
        self.std = torch.zeros(num_envs, 1, device=device)
        self.settings: dict[str, Any] = {"batch_size": config.batch_size}

    @torch.no_grad()
    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        """Returns exploring actions; each environment's noise scale is sampled at every episode."""
        config = self.config
        std = torch.rand_like(self.std) * (config.std_max - config.std_min) + config.std_min
        self.std = torch.where(first[:, None], std, self.std)
        self.policy.norm.update(observation)
        action = self.policy.actor(self.policy.norm(observation))
        return (action + self.std * torch.randn_like(action)).clamp(-1.0, 1.0)

    def store(self, observation: Tensor, action: Tensor, step: Any) -> None:
        """Stores the step that followed the actions."""
        ended = step.terminated.float()
        lived = Transitions(observation, action, step.reward, ended, step.final_obs)
        self.buffer.add(lived, step.terminated | step.truncated)
        if len(self.buffer) >= self.first_steps:
            self.due += self.config.num_updates

    def must_learn(self) -> bool:
        """Whether an update is due."""
        return self.due > 0 and len(self.buffer) >= self.first_steps

    def learn(self) -> Mapping[str, Tensor]:
        """Makes an update."""
        self.due -= 1
        batch = self.buffer.returns(self.batch_size, self.config.num_steps, self.config.discount)
        return self.updater.update(*batch)

    def set_progress(self, fraction: float) -> None:
        """The learning rates stay as they are."""

    def may_stop(self) -> bool:
        """A step is stored as soon as it is made."""
        return True

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Returns the state that resuming needs."""
        updater = self.updater
        numbers: dict[str, Any] = {"updates": updater.updates, "due": self.due}
        tensors = checkpoint.named(self.policy.state_dict(), "policy")
        tensors |= checkpoint.named(updater.target.state_dict(), "target")
        tensors |= checkpoint.moments(updater.critic_optimizer, "critic")
        tensors |= checkpoint.moments(updater.actor_optimizer, "actor")
        tensors |= {"std": self.std}
        if self.config.save_replay:
            stored, numbers["replay"] = self.buffer.state()
            tensors |= checkpoint.named(stored, "replay")
        return tensors, numbers

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Takes back what :meth:`state` returned."""
        updater, part = self.updater, checkpoint.part
        self.policy.model.load_state_dict(part(tensors, "policy"))
        updater.target.load_state_dict(part(tensors, "target"))
        checkpoint.load_moments(updater.critic_optimizer, tensors, "critic")
        checkpoint.load_moments(updater.actor_optimizer, tensors, "actor")
        self.std.copy_(tensors["std"])
        updater.updates, self.due = numbers["updates"], numbers.get("due", 0)
        if "replay" in numbers:
            self.buffer.load(part(tensors, "replay"), numbers["replay"])
        else:
            self.first_steps = max(self.first_steps, min(self.batch_size, self.buffer.capacity))


class FastTd3Learner(AgentLearner):
    """Trains FastTD3."""

    @override
    def check(self) -> None:
        check_env(self.config)

    @override
    def open_env(self, seed: int) -> Any:
        return make_env(self.config, self.config.policy.num_envs, seed, self.device)

    @override
    def make_agent(self, env: Any, seed: int) -> FastTd3Algorithm:
        own: FastTd3Config = self.config.policy
        sizes = {loop.OBSERVATION: env.observation_size}
        policy = FastTd3Policy.create(own, sizes, env.action_size, self.device, seed)
        policy.task = self.config.env.task
        return FastTd3Algorithm(policy, own.num_envs)

    @override
    @staticmethod
    def brief(own: FastTd3Config) -> FastTd3Config:
        """Returns settings with the same ratio of batch size to environments."""
        num_envs = max(1, min(own.num_envs, own.num_envs * _TIMED_BATCH // own.batch_size))
        return replace(
            own,
            num_envs=num_envs,
            batch_size=max(1, own.batch_size * num_envs // own.num_envs),
            learning_starts=0,
            buffer_size=num_envs * _TIMED_STEPS,
            compile=False,
        )
