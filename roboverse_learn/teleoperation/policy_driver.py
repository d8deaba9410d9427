"""A policy that acts until the person takes over."""

from collections import deque
from typing import Any

import numpy as np

from benchmark.runner import PolicyActor
from envs.core.errors import ConfigError
from envs.rollout import Episode
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.commands.tested_checkpoint import TestedCheckpoint, checkpoint_to_test
from roboverse_learn.config.other_commands import TeleoperateConfig
from roboverse_learn.config.schema import EvaluateConfig
from roboverse_learn.teleoperation.station import Station


def find_policy(config: TeleoperateConfig) -> TestedCheckpoint:
    """Returns the checkpoint of a configuration, and the environment that it was trained in.

    Raises:
        PolicyError: There is no checkpoint, or it learned other tasks.
        ConfigError: Its policy learned from rewards: its actions are not those of demonstrations.
    """
    import policies
    from policies.checkpoint import policy_type

    given = EvaluateConfig(checkpoint=config.checkpoint, env={"task": config.env.task}, device=config.device)
    found = checkpoint_to_test(given)
    assert found.checkpoint is not None, "a checkpoint was given"
    name = policy_type(found.checkpoint)
    if policies.learns_from(name) != "dataset":
        raise ConfigError(
            f"Checkpoint '{found.checkpoint}' is of policy '{name}', which learned from rewards. Corrections "
            f"are for policies that learn from demonstrations: {', '.join(policies.names('dataset'))}."
        )
    return found


def load_driver(config: TeleoperateConfig, env: RoboVerseVectorEnv) -> "PolicyDriver":
    """Returns the policy of the checkpoint of a configuration, with its weights in memory once more."""
    import policies
    from envs.core.fingerprint import file_hash
    from policies.checkpoint import policy_type, resolve, weights_path
    from roboverse_learn.training.device import resolve_device

    folder = resolve(config.checkpoint)
    policy = policies.load(folder, resolve_device(config.device))
    policy.task = env.task.name
    facts = {"policy": policy_type(folder), "weights": file_hash(weights_path(folder))[:16]}
    return PolicyDriver(policy, env, facts)


class PolicyDriver:
    """Acts as in an evaluation: with the same observations, chunks of actions and noise.

    Args:
        policy: The policy.
        env: The environments; their observations are those of the policy.
        facts: JSON-able: what recordings say of it.
    """

    def __init__(self, policy: Any, env: RoboVerseVectorEnv, facts: dict[str, Any] | None = None) -> None:
        self.facts = facts or {}
        self._actor = PolicyActor(policy, env, env.protocol_seed)
        self._history = self._actor.n_obs_steps

    def begin(self, episode: int) -> None:
        """Prepares for an episode, or for the rest of one that the person hands back."""
        self._episode = Episode(
            position=0, episode=episode, env_id=0, observations=deque(maxlen=self._history)
        )
        self._actor.begin([self._episode])

    def act(self, station: Station) -> np.ndarray:
        """Returns the next action of the task, (A,) float32; renders where the policy looks."""
        episode = self._episode
        if len(episode.plan) < self._history:
            episode.observations.append(station.observe())
        if not episode.plan:
            (chunk,) = self._actor.act([episode], lambda: station.state)
            episode.plan.extend(chunk)
        return episode.plan.popleft().astype(np.float32)
