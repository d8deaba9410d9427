"""TD-MPC2 in many environments at once: seed steps, then updates by their ratio to environment steps."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, override

import torch
from torch import Tensor

from envs.core.observation_keys import IMAGE_PREFIX
from policies.tdmpc2.agent import Tdmpc2Agent
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.layers import PIXELS
from policies.tdmpc2.policy import TaskSizes, Tdmpc2Policy
from policies.tdmpc2.update import Sequences, Updater
from roboverse_learn.training import checkpoint
from roboverse_learn.training.learners import AgentLearner
from roboverse_learn.training.rl import loop
from roboverse_learn.training.rl.environment import (
    check_env,
    check_images,
    make_env,
    make_multi_task_env,
    make_pixel_env,
)
from roboverse_learn.training.rl.frame_buffer import FrameReplay
from roboverse_learn.training.rl.replay_buffer import ReplayBuffer, Transitions, check_room

_TIMED_ENVS, _TIMED_STEPS = 8, 100


class Tdmpc2Algorithm:
    """TD-MPC2 (arXiv:2310.16828), as the loop in :mod:`roboverse_learn.training.rl.loop` has it.

    Args:
        policy: An untrained policy, trained in place.
        num_envs: Environments.
        episode_length: Control steps of an episode; of several tasks, of the longest.
        task_ids: Index of each environment's task (N,), or None where there is one alone.
    """

    def __init__(
        self, policy: Tdmpc2Policy, num_envs: int, episode_length: int, task_ids: Tensor | None = None
    ) -> None:
        config, model = policy.config, policy.model
        self.policy, self.config, self.batch_size = policy, config, config.batch_size
        self.num_envs, self.action_size, self.task_ids = num_envs, model.action_size, task_ids
        compiled = {
            "compile": loop.wanted(config.compile, policy.device),
            "cuda_graphs": loop.wanted(config.cuda_graphs, policy.device),
        }
        self.updater = Updater(config, model, policy.discounts, **compiled)
        discount = policy.discount if task_ids is None else self.updater.discounts[task_ids][:, None]
        self.agent = Tdmpc2Agent(config, model, discount, num_envs, task_ids, **compiled)
        self.buffer = _buffer_of(policy, num_envs)
        lengths = [task.episode_length for task in policy.several.values()] or [episode_length]
        self.first_steps = max(config.first_steps(*lengths), config.horizon * num_envs)
        check_room(self.buffer, config.buffer_size, self.first_steps, "policy.seed_steps")
        self.learning, self.due = False, 0.0
        self.settings: dict[str, Any] = {"batch_size": config.batch_size, "model_size": config.model_size}
        if config.observation == "pixels":
            self.settings["cameras"] = [key.removeprefix(IMAGE_PREFIX) for key in policy.sizes]
        if policy.several:
            self.settings["tasks"] = list(policy.several)

    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        """Chooses actions, at random until there is something to learn from."""
        if self.learning:
            return self.agent.act(observation, first)
        action = torch.rand(self.num_envs, self.action_size, device=observation.device) * 2.0 - 1.0
        mask = self.policy.model.action_mask(self.task_ids)
        return action if mask is None else action * mask  # padding is learned as the zeros that are planned

    def store(self, observation: Tensor, action: Tensor, step: Any) -> None:
        """Stores the step that followed the actions."""
        ended = step.terminated.float()
        self.buffer.add(
            Transitions(observation, action, step.reward, ended, step.final_obs),
            step.terminated | step.truncated,
        )
        if len(self.buffer) >= self.first_steps:
            new_steps = self.num_envs if self.learning else len(self.buffer)
            self.learning = True
            self.due += new_steps * self.config.update_ratio

    def must_learn(self) -> bool:
        """Whether an update is due; after the seed steps, as many are as those would have made due."""
        return self.due >= 1.0 and len(self.buffer) >= self.first_steps

    def learn(self) -> Mapping[str, Tensor]:
        """Makes an update."""
        self.due -= 1.0
        return self.updater.update(self._drawn())

    def _drawn(self) -> Sequences:
        """Draws a batch; an environment is of one task for ever, so the replay need not keep it."""
        *fields, env = self.buffer.sequences(self.batch_size)
        return Sequences(*fields, task=None if self.task_ids is None else self.task_ids[env])

    def set_progress(self, fraction: float) -> None:
        """TD-MPC2 has no schedule."""

    def may_stop(self) -> bool:
        """A step is stored as soon as it is made."""
        return True

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Returns the state that resuming needs."""
        updater = self.updater
        numbers: dict[str, Any] = {"learning": self.learning, "due": self.due}
        tensors = checkpoint.named(self.policy.state_dict(), "policy")
        tensors |= checkpoint.moments(updater.optimizer, "world")
        tensors |= checkpoint.moments(updater.prior_optimizer, "prior")
        tensors |= {"scale": updater.scale.value, "mean": self.agent.mean}
        if self.config.save_replay:
            stored, where = self.buffer.state()
            tensors |= checkpoint.named(stored, "replay")
            numbers["replay"] = where
        return tensors, numbers

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Takes back what :meth:`state` returned."""
        updater, part = self.updater, checkpoint.part
        self.policy.model.load_state_dict(part(tensors, "policy"))
        checkpoint.load_moments(updater.optimizer, tensors, "world")
        checkpoint.load_moments(updater.prior_optimizer, tensors, "prior")
        updater.scale.value.copy_(tensors["scale"])
        self.agent.mean.copy_(tensors["mean"])
        self.learning, self.due = numbers["learning"], numbers["due"]
        if "replay" in numbers:
            self.buffer.load(part(tensors, "replay"), numbers["replay"])


class Tdmpc2Learner(AgentLearner):
    """Trains TD-MPC2 from states or images, on one task or several together."""

    @override
    def check(self) -> None:
        if self.config.policy.observation == "pixels":
            check_images(self.config, PIXELS)
        else:
            check_env(self.config)

    @override
    def open_env(self, seed: int) -> Any:
        config, device = self.config, self.device
        own: Tdmpc2Config = config.policy
        if own.tasks:
            return make_multi_task_env(config, own.num_envs, seed, device)
        if own.observation != "pixels":
            return make_env(config, own.num_envs, seed, device)
        seen: dict[str, Any] = {"num_frames": own.num_frames, "image_size": PIXELS}
        return make_pixel_env(config, own.num_envs, seed, device, **seen)

    @override
    def make_agent(self, env: Any, seed: int) -> Tdmpc2Algorithm:
        own: Tdmpc2Config = self.config.policy
        sizes = {loop.OBSERVATION: env.observation_size}
        if own.observation == "pixels":
            sizes = {f"{IMAGE_PREFIX}{camera}": PIXELS for camera in env.camera_names}
        length, task_ids, several = env.max_episode_steps, None, {}
        if own.tasks:
            task_ids = env.task_ids
            for task, each in env.envs.items():
                several[task] = TaskSizes(each.observation_size, each.action_size, each.max_episode_steps)
        policy = Tdmpc2Policy.create(own, sizes, env.action_size, length, self.device, seed, several)
        policy.task = self.config.env.task
        return Tdmpc2Algorithm(policy, own.num_envs, length, task_ids)

    @override
    @staticmethod
    def brief(own: Tdmpc2Config) -> Tdmpc2Config:
        """Returns settings with few environments, which each plan as long, and learn at once."""
        num_envs = min(own.num_envs, max(_TIMED_ENVS, 1 + len(own.tasks)))
        buffer_size = num_envs * (own.horizon + _TIMED_STEPS)
        return replace(own, num_envs=num_envs, seed_steps=1, buffer_size=buffer_size, compile=False)


def _buffer_of(policy: Tdmpc2Policy, num_envs: int) -> ReplayBuffer | FrameReplay:
    config, kept = policy.config, {"action_size": policy.model.action_size, "device": policy.device}
    kept["horizon"] = config.horizon
    if config.observation == "pixels":
        frame = (3 * len(policy.sizes), PIXELS, PIXELS)
        return FrameReplay(config.buffer_size, num_envs, frame, config.num_frames, **kept)
    return ReplayBuffer(config.buffer_size, num_envs, sum(policy.sizes.values()), **kept)
