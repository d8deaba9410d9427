"""Demonstrations of a policy that was trained by reinforcement learning."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.base import DemonstrationSource
from roboverse_learn.data.sources.expert import ExpertEpisodes

OBSERVATION = "observation.environment_state"
"""Key of the whole observation that such a policy takes."""


class PolicyPlanner:
    """A policy with the interface of an expert: its next action, in the task's own actions.

    Args:
        policy: A policy that was trained on the task by reinforcement learning.
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
    """The demonstrating policy.

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
        ConfigError: Its policy learned from demonstrations itself, or sees images.
    """
    import policies
    from envs.core.fingerprint import file_hash
    from policies.checkpoint import WEIGHTS, check_learned, policy_type, resolve, seen_cameras

    folder = resolve(checkpoint)
    name = policy_type(folder)
    if policies.learns_from(name) != "env":
        raise ConfigError(
            f"Checkpoint '{folder}' is of policy '{name}', which learned from demonstrations itself. "
            f"source=policy takes reinforcement learning policies: {', '.join(policies.names('env'))}."
        )
    if cameras := seen_cameras(folder):
        raise ConfigError(
            f"Checkpoint '{folder}' of policy '{name}' sees the images of {', '.join(cameras)}. "
            "source=policy takes what sees the state: train one with policy.observation=state."
        )
    check_learned(folder, task)
    return Demonstrator(checkpoint=folder, policy=name, weights=file_hash(folder / WEIGHTS)[:16])


class PolicySource(DemonstrationSource):
    """``source=policy``."""

    episodes: ClassVar = "roboverse_learn.data.sources.policy:PolicyEpisodes"
    native_observations: ClassVar = True
    needs: ClassVar = {
        "checkpoint": "<folder>: that of a run of a policy that was trained by reinforcement learning, as in "
        "checkpoint=runs/PickCube/ppo/<run>."
    }
    demonstrates: ClassVar = "the policy"

    @classmethod
    @override
    def task_of(cls, values: Mapping[str, Any]) -> str | None:
        from policies.checkpoint import learned_tasks

        return next(iter(learned_tasks(str(values["checkpoint"]))), None)

    @cached_property
    def demonstrator(self) -> Demonstrator:
        """The policy of the checkpoint."""
        return find_demonstrator(self.config.checkpoint, self.config.env.task)

    @override
    def check(self) -> None:
        """Refuses a policy that was trained at another control rate than the dataset's."""
        from roboverse_learn.commands.run_folder import read_config, run_of

        folder = run_of(self.demonstrator.checkpoint)
        if folder is None:
            return
        trained = read_config(folder)
        learned, requested = trained.learned_hz(self.config.env.task), self.config.env.control_hz
        if learned != requested:
            changes = trained.env.scenario.get("physics", {})
            words = [f"scenario.physics.{key}={value}" for key, value in changes.items()]
            remedy = f"Add {' '.join(words)}." if words else "Leave out scenario.physics."
            raise ConfigError(
                f"The policy of '{folder}' learned at {learned:g} control steps per second, and "
                f"{requested:g} were requested. {remedy}"
            )

    @override
    def name_part(self) -> str:
        return f"{self.demonstrator.policy}-{self.demonstrator.weights[:8]}"

    @override
    def identity(self) -> dict[str, Any]:
        return self.demonstrator.identity()

    @override
    def arguments(self) -> dict[str, Any]:
        from roboverse_learn.training.device import resolve_device

        return super().arguments() | {
            "checkpoint": str(self.demonstrator.checkpoint),
            "identity": self.identity(),
            "device": resolve_device("auto"),
        }

    @override
    def advice(self) -> str:
        return f"The policy of '{self.config.checkpoint}' needs more training, or learned in another scene."


class PolicyEpisodes(ExpertEpisodes):
    """Runs a policy in a batch of environments of the train split.

    Its actions are recorded as the task's own, such as joint targets, so that what learns from them can be
    evaluated like any other policy.

    Args:
        checkpoint: Pretrained folder.
        identity: Of the :class:`Demonstrator`.
        device: Torch device of the policy.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(self, *, checkpoint: str, identity: dict[str, Any], device: str, **scene: Any) -> None:
        import policies

        super().__init__(**scene)
        self._facts = identity
        policy: Any = policies.load(checkpoint, device)
        policy.task = self._env.task.name
        self._planner = PolicyPlanner(policy, self._env.task)

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        for outcome in expert_episodes(self._env, list(indices), self._planner):
            yield int(outcome.episode), self._episode(outcome, **self._facts) if outcome.success else None
