"""Learners, which train the policy of a run.

A policy's entry in :data:`policies.POLICIES` names its learner: a name in :data:`LEARNERS`, or the
``"module:Class"`` of a :class:`Learner` elsewhere.
"""

import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import policies
from envs.core.errors import ConfigError
from envs.core.registry import Registry

if TYPE_CHECKING:
    from roboverse_learn.config.schema import TrainRunConfig
    from roboverse_learn.training.reporter import Reporter, TrainResult

log = logging.getLogger(__name__)

LEARNERS: "Registry[type[Learner]]" = Registry("learner")
LEARNERS.add("imitation", "roboverse_learn.training.imitation.learner:ImitationLearner")
LEARNERS.add("fasttd3", "roboverse_learn.training.rl.fasttd3:FastTd3Learner")
LEARNERS.add("ppo", "roboverse_learn.training.rl.ppo.learner:PpoLearner")
LEARNERS.add("tdmpc2", "roboverse_learn.training.rl.tdmpc2:Tdmpc2Learner")


type Demonstrations = str | Mapping[str, str]
"""Folder of a dataset, or of the dataset of each of several tasks."""


class Learner:
    """Trains the policy of a run.

    Args:
        config: The whole configuration; ``config.policy`` is the policy's own.
        device: ``cpu`` or ``cuda``.
    """

    def __init__(self, config: "TrainRunConfig", device: str) -> None:
        self.config, self.device = config, device

    def check(self) -> None:
        """Checks, before the run has a folder, that the policy can be trained.

        Raises:
            MissingExtraError: if a package that it needs is not installed.
            ConfigError: if the task cannot be learned so, as one without a reward.
        """

    def too_few_steps(self) -> str:
        """Says why the steps of the run are too few to learn anything; empty where they are not."""
        return ""

    def estimate_s(self) -> float:
        """Measures how many seconds training will take on this machine."""
        raise NotImplementedError

    def learn(
        self, run_dir: Path, dataset: Demonstrations | None, seed: int, reporter: "Reporter"
    ) -> "TrainResult":
        """Trains until the steps or the time of ``config.train`` are over.

        Resumes from the last checkpoint of ``run_dir``; writes metrics, curves and checkpoints there.

        Args:
            run_dir: Folder of the run.
            dataset: Folder of the demonstrations, or of those of each task; None for a policy that
                learns from an environment.
            seed: Root of all randomness.
            reporter: Is informed of the progress.

        Raises:
            TrainingDivergedError: if a loss or a weight is no longer finite.
        """
        raise NotImplementedError


class AgentLearner(Learner):
    """Trains a reinforcement learning agent in the environments of its task.

    Subclasses make the environments and the agent, and give shorter settings to time it with.
    """

    def open_env(self, seed: int) -> Any:
        """Makes the environments."""
        raise NotImplementedError

    def make_agent(self, env: Any, seed: int) -> Any:
        """Makes an untrained :class:`~roboverse_learn.training.rl.loop.Algorithm`."""
        raise NotImplementedError

    @staticmethod
    def brief(own: Any) -> Any:
        """Returns smaller settings of the policy, with which an environment step takes as long."""
        raise NotImplementedError

    def estimate_s(self) -> float:
        """Measures environment steps and updates of a smaller agent."""
        from roboverse_learn.training.rl.estimate import estimate_learning_s

        brief = replace(self.config, policy=self.brief(self.config.policy))
        return estimate_learning_s(type(self)(brief, self.device))

    def learn(
        self, run_dir: Path, dataset: Demonstrations | None, seed: int, reporter: "Reporter"
    ) -> "TrainResult":
        """See :meth:`Learner.learn`."""
        env = self.open_env(seed)
        try:
            agent = self.make_agent(env, seed)
            steps, first_steps = self.config.train.steps, getattr(agent, "first_steps", 0)
            if steps < first_steps:
                log.warning(
                    "train.steps=%d end before the first update, which comes after %d steps of the "
                    "environments: nothing is learned. Give more steps.", steps, first_steps
                )  # fmt: skip
            return self.run(agent, env, run_dir, seed, reporter)
        finally:
            env.close()

    def run(self, agent: Any, env: Any, run_dir: Path, seed: int, reporter: "Reporter") -> "TrainResult":
        """Trains an agent in an environment."""
        from roboverse_learn.training.rl import loop

        return loop.run(agent, env, self.config.train, run_dir, seed=seed, reporter=reporter)


def learner_of(config: "TrainRunConfig", device: str) -> Learner:
    """Makes the learner of a run.

    Raises:
        UnknownNameError: if the policy or its learner is not registered.
        ConfigError: if the policy needs no training, or is an agent under ``accelerate launch`` or with
            ``train.resume_from`` or ``train.mixing``.
        MissingExtraError: if a package that it needs is not installed.
    """
    name = config.policy_name
    target = policies.learner(name)
    if not target:
        raise ConfigError(f"policy={name} needs no training. Trainable: {', '.join(policies.names())}.")
    found = policies.resolve(target) if ":" in target else LEARNERS.get(target)
    if issubclass(found, AgentLearner) and int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ConfigError(
            f"policy={name} learns in one process; start it without `accelerate launch`. It uses one GPU "
            "fully with more environments: raise policy.num_envs."
        )
    for key in ("resume_from", "mixing"):
        if issubclass(found, AgentLearner) and getattr(config.train, key):
            raise ConfigError(
                f"policy={name} takes no train.{key}, which is for demonstrations; leave it out."
            )
    return found(config, device)
