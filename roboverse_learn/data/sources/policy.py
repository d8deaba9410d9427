"""Demonstrations of a policy that learned a task by reward, as the collection wants them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, override

import numpy as np

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.expert import ExpertSource

OBSERVATION = "observation.environment_state"
"""The key under which such a policy is given the whole observation."""


class PolicyPlanner:
    """A policy behind the interface of an expert: what it does next, in the task's own actions.

    Args:
        policy: A policy that learned the task by reward.
        task: The task.
    """

    def __init__(self, policy: Any, task: Task) -> None:
        self._policy, self._task, self._controller = policy, task, task.rl_controller

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next action (1, A) float32 from a state of one row."""
        return self.plan_batch(state, [rng])[0]

    def plan_batch(self, state: State, rngs: Sequence[np.random.Generator]) -> list[np.ndarray]:
        """Returns the next action (1, A) from each row of ``state``."""
        del rngs  # the policy adds no noise
        seen = self._task.rl_observation(state).cpu().numpy().astype(np.float32)
        actions = self._policy.act({OBSERVATION: seen})[:, 0]
        return list(self._controller.as_task_actions(state, actions)[:, None].astype(np.float32))


@dataclass(frozen=True, kw_only=True, slots=True)
class Demonstrator:
    """Which policy demonstrates.

    Attributes:
        checkpoint: Its pretrained folder.
        policy: Its registered name.
        weights: First digits of the SHA-256 of its weights.
    """

    checkpoint: Path
    policy: str
    weights: str

    def identity(self) -> dict[str, Any]:
        """Returns what a dataset that is continued must have in common with its beginning."""
        return {"source": "policy", "policy": self.policy, "weights": self.weights}


def find_demonstrator(checkpoint: str, task: str) -> Demonstrator:
    """Finds out which policy a checkpoint holds, and whether it can demonstrate a task.

    Args:
        checkpoint: Folder of a checkpoint, or of a run.
        task: Registered task.

    Raises:
        PolicyError: There is no checkpoint, or it learned another task.
        ConfigError: Its policy learned from demonstrations itself, or sees pictures.
    """
    import policies
    from benchmark.provenance import file_hash
    from policies.checkpoint import WEIGHTS, check_learned, policy_type, resolve, seen_cameras

    folder = resolve(checkpoint)
    name = policy_type(folder)
    if policies.learns_from(name) != "env":
        raise ConfigError(
            f"Checkpoint '{folder}' is of policy '{name}', which learned from demonstrations itself. "
            f"source=policy takes what learned by reward: {', '.join(policies.names('env'))}."
        )
    if cameras := seen_cameras(folder):
        raise ConfigError(
            f"Checkpoint '{folder}' of policy '{name}' sees the pictures of {', '.join(cameras)}. "
            "source=policy takes what sees the state: train one with policy.observation=state."
        )
    check_learned(folder, task)
    return Demonstrator(checkpoint=folder, policy=name, weights=file_hash(folder / WEIGHTS)[:16])


class PolicySource(ExpertSource):
    """Runs a policy in a batch of environments of the train split.

    Its actions are recorded as the task's own, such as joint targets, so that what learns from them may
    be evaluated like any other policy.

    Args:
        checkpoint: Pretrained folder.
        identity: Of the :class:`Demonstrator`.
        device: Torch device of the policy.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertSource`.
    """

    def __init__(self, *, checkpoint: str, identity: dict[str, Any], device: str, **scene: Any) -> None:
        import policies

        super().__init__(**scene)
        self._facts = identity
        policy: Any = policies.load(checkpoint, device)
        policy.task = scene["task"]
        self._planner = PolicyPlanner(policy, self._env.task)

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        for outcome in expert_episodes(self._env, list(indices), self._planner):
            yield int(outcome.episode), self._episode(outcome, **self._facts) if outcome.success else None


def make_policy_source(**kwargs: Any) -> PolicySource:
    """Builds a :class:`PolicySource`: what collecting processes call by name."""
    return PolicySource(**kwargs)
