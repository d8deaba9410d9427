"""Trains PPO on the task of a run, by the backend that the configuration names."""

import importlib
import importlib.util
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, override

import torch

from envs.core.errors import ConfigError, MissingExtraError
from envs.core.extras import install_command
from envs.core.observation_keys import IMAGE_PREFIX
from policies.ppo.config import PpoConfig
from policies.ppo.network import LEAST_PIXELS
from policies.ppo.policy import STATE, PpoPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.learners import AgentLearner
from roboverse_learn.training.rl import loop
from roboverse_learn.training.rl.environment import check_env, check_images, make_env, make_pixel_env
from roboverse_learn.training.rl.ppo.algorithm import PpoAlgorithm

if TYPE_CHECKING:
    from roboverse_learn.training.reporter import Reporter, TrainResult

_TIMED_ENVS, _TIMED_STEPS = 128, 8
_FOLDER = "roboverse_learn.training.rl.ppo"
_CLASSES = {"rsl_rl": "RslRlPpo", "sb3": "Sb3Ppo", "torchrl": "TorchRlPpo"}
_PACKAGES = {"rsl_rl": "rsl_rl", "sb3": "stable_baselines3", "torchrl": "torchrl"}
_EXTRAS = {"rsl_rl": "rsl-rl", "sb3": "sb3", "torchrl": "torchrl"}


class PpoLearner(AgentLearner):
    """Trains PPO."""

    @override
    def check(self) -> None:
        own: PpoConfig = self.config.policy
        check_installed(own.backend)
        if own.observation == "state":
            check_env(self.config, expert_starts=own.expert_starts)
            return
        size = self.config.env.image_size
        if size < LEAST_PIXELS:
            raise ConfigError(
                f"image_size={size} is too small for the convolutions of policy=ppo, which need "
                f"{LEAST_PIXELS} pixels a side. Take image_size=64."
            )
        check_images(self.config, size, expert_starts=own.expert_starts)

    @override
    def open_env(self, seed: int) -> Any:
        config, device = self.config, self.device
        own: PpoConfig = config.policy
        training: dict[str, Any] = {
            "max_episode_steps": own.max_episode_steps,
            "substeps": own.substeps,
            "expert_starts": own.expert_starts,
        }
        if own.observation == "state":
            return make_env(config, own.num_envs, seed, device, **training)
        return make_pixel_env(
            config,
            own.num_envs,
            seed,
            device,
            num_frames=own.num_frames,
            image_size=config.env.image_size,
            observation="pixels_and_state",
            **training,
        )

    @override
    def make_agent(self, env: Any, seed: int) -> PpoAlgorithm:
        return _agent(self.config.policy, env, self.config.train, self.config.env.task, seed)

    @override
    @staticmethod
    def brief(own: PpoConfig) -> PpoConfig:
        """Returns settings with rollouts of few steps of few environments."""
        if own.num_envs <= _TIMED_ENVS:
            return replace(own, expert_starts=0.0)
        # A multiple of the minibatches, which divide a rollout of any number of steps then.
        num_envs = math.ceil(_TIMED_ENVS / own.num_minibatches) * own.num_minibatches
        return replace(own, num_envs=num_envs, num_steps=min(own.num_steps, _TIMED_STEPS), expert_starts=0.0)

    @override
    def run(self, agent: Any, env: Any, run_dir: Path, seed: int, reporter: "Reporter") -> "TrainResult":
        return _run(agent, env, self.config.train, run_dir, seed, reporter)


def train(
    config: PpoConfig,
    env: Any,
    train_config: TrainConfig,
    run_dir: Path,
    task: str,
    *,
    seed: int = 0,
    reporter: "Reporter | None" = None,
) -> "TrainResult":
    """Trains PPO on an env.

    Args:
        config: Settings of PPO.
        env: A :class:`~envs.torch_env.TorchVectorEnv`, or what has its interface.
        train_config: How long to train, how often to log and save; rounded up to whole rollouts.
        run_dir: Where checkpoints, metrics and plots go.
        task: Name of the task.
        seed: Root of all randomness.
        reporter: Hears of the progress.
    """
    agent = _agent(config, env, train_config, task, seed)
    return _run(agent, env, train_config, run_dir, seed, reporter)


def _run(
    agent: PpoAlgorithm, env: Any, config: TrainConfig, run_dir: Path, seed: int, reporter: "Reporter | None"
) -> "TrainResult":
    own: PpoConfig = agent.config
    config, stagger = whole_rollouts(config, own.rollout_size), own.stagger
    return loop.run(agent, env, config, run_dir, seed=seed, reporter=reporter, stagger=stagger)


def _agent(config: PpoConfig, env: Any, train_config: TrainConfig, task: str, seed: int) -> PpoAlgorithm:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        policy = PpoPolicy(config, _sizes(config, env), env.action_size, env.device)
        policy.task = task
        return make_algorithm(policy, env, train_config)


def _sizes(config: PpoConfig, env: Any) -> dict[str, int]:
    """Returns the sizes of what the policy sees, as :class:`PpoPolicy` has them."""
    if config.observation == "state":
        return {loop.OBSERVATION: env.observation_size}
    cameras = {f"{IMAGE_PREFIX}{camera}": env.image_size for camera in env.camera_names}
    return cameras | {STATE: env.num_state}


def make_algorithm(policy: PpoPolicy, env: Any, train_config: TrainConfig) -> PpoAlgorithm:
    """Makes the PPO of the backend that the policy's configuration names."""
    backend = policy.config.backend
    module = importlib.import_module(f"{_FOLDER}.{backend}")
    return getattr(module, _CLASSES[backend])(policy, env, train_config)


def whole_rollouts(config: TrainConfig, size: int) -> TrainConfig:
    """Returns the configuration with steps between events rounded up to multiples of a rollout."""

    def up(steps: int) -> int:
        return math.ceil(steps / size) * size

    return replace(
        config, steps=up(config.steps), save_every=up(config.save_every), log_every=up(config.log_every)
    )


def check_installed(backend: str) -> None:
    """Checks that a backend's package is there.

    Raises:
        MissingExtraError: if not; it says how to install it.
    """
    if importlib.util.find_spec(_PACKAGES[backend]) is None:
        there = [name for name, package in _PACKAGES.items() if importlib.util.find_spec(package)]
        raise MissingExtraError(
            f"policy.backend={backend} needs the package '{_PACKAGES[backend]}', which is not installed. "
            f"Install it with: {install_command(_EXTRAS[backend])}. "
            f"Installed backends: {', '.join(there) or 'none'}."
        )
