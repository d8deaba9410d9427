"""Policies that learn from an env that they act in: which function trains which.

A learner is a function ``learn(config, run_dir, device, seed, reporter) -> TrainResult``. It makes its
env from ``config.env.task``, ``config.env.simulator`` and ``config.env.task_kwargs``, goes on from the last
checkpoint of ``run_dir``, writes ``metrics.jsonl``, TensorBoard, curves and checkpoints there, and stops
after ``config.train.steps`` environment steps or ``config.train.time_limit_s`` seconds.
"""

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from envs.core.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from roboverse_learn.config.schema import TrainRunConfig
    from roboverse_learn.training.reporter import Reporter, TrainResult

LEARNERS: dict[str, str] = {
    "fasttd3": "roboverse_learn.training.rl.fasttd3",
    "tdmpc2": "roboverse_learn.training.rl.tdmpc2",
    "ppo": "roboverse_learn.training.rl.ppo.learner",
}
"""Policy to the module that makes what it is trained with:

``check(config)`` tells what keeps it from learning. ``open_env(config, seed, device)`` and
``make_agent(config, env, seed, device)`` make what :func:`learn` trains with; a module may have a ``learn``
of its own. ``brief(policy)`` returns smaller settings, by which
:mod:`roboverse_learn.training.imitation.estimate` times it: it learns from the first steps on, and an
environment step takes as long as by the settings given.
"""


class Learner(Protocol):
    """Trains one policy."""

    def __call__(
        self, config: "TrainRunConfig", run_dir: Path, device: str, seed: int, reporter: "Reporter"
    ) -> "TrainResult":
        """Trains until done; see the module's docstring.

        Args:
            config: The whole configuration; ``config.policy`` is the policy's own.
            run_dir: Folder of the run.
            device: ``cpu`` or ``cuda``.
            seed: Root of all randomness.
            reporter: Hears of the progress.

        Raises:
            MissingExtraError: if a package that it needs is not installed.
            ConfigError: if the task cannot be learned so.
            TrainingDivergedError: if a loss or a weight is no longer finite.
        """
        ...


def module_of(policy: str) -> Any:
    """Returns the module that trains a policy.

    Raises:
        UnknownNameError: if no learner is registered for it.
        ConfigError: under ``accelerate launch`` with several processes.
    """
    if policy not in LEARNERS:
        raise unknown_name("policy that learns from an env", policy, LEARNERS)
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ConfigError(
            f"policy={policy} learns in one process; start it without `accelerate launch`. It uses one GPU "
            "fully with more environments: raise policy.num_envs."
        )
    return importlib.import_module(LEARNERS[policy])


def learner_of(policy: str) -> Learner:
    """Returns the function that trains a policy.

    Raises:
        RoboVerseError: as :func:`module_of`.
    """
    return getattr(module_of(policy), "learn", learn)


def learn(
    config: "TrainRunConfig", run_dir: Path, device: str, seed: int, reporter: "Reporter"
) -> "TrainResult":
    """Trains the policy of a run on its task; see :class:`Learner`."""
    from roboverse_learn.training.rl import loop as off_policy

    module = module_of(config.policy_name)
    env = module.open_env(config, seed, device)
    try:
        agent = module.make_agent(config, env, seed, device)
        return off_policy.run(agent, env, config.train, run_dir, seed=seed, reporter=reporter)
    finally:
        env.close()


def check_learner(config: "TrainRunConfig") -> None:
    """Tells what keeps a policy from learning from the env of a run, before the run has a folder.

    Raises:
        RoboVerseError: as :func:`module_of` and :class:`Learner`, for a package, a reward or an expert that
            is not there.
    """
    module_of(config.policy_name).check(config)
