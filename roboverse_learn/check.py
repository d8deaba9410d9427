"""``python roboverse_learn/check.py task=…``: the contracts of a task, a policy or a robot."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from envs.core.errors import ConfigError
from roboverse_learn.checks.report import Checked
from roboverse_learn.config.other_commands import CheckConfig
from roboverse_learn.progress import StageProgress


def check(config: CheckConfig) -> Checked:
    """Looks at every contract of a task, or of the policy or robot that is named.

    Raises:
        UnknownNameError: There is no such policy, robot or contract.
        ConfigError: The policy does not learn from demonstrations.
        MissingExtraError: The simulator or a package of the task is not installed.
    """
    from roboverse_learn.checks.contract import chosen, run

    what, contracts, checked = _checked(config)
    contracts = chosen(contracts, config.contracts, config.without)
    with _closing(checked), StageProgress(f"checking {what}") as shown:
        order = [each.name for each in contracts]
        findings = list(
            run(contracts, checked, lambda name: shown.update(order.index(name), len(order), name))
        )
    return Checked(what=what, contracts=contracts, findings=findings)


def _checked(config: CheckConfig) -> tuple[str, Sequence[Any], Any]:
    """Returns what is checked in words, its contracts, and what they look at."""
    if not config.env.task:
        from envs.robots import ROBOTS
        from roboverse_learn.checks.robots import ROBOT_CONTRACTS, CheckedRobot

        robot = config.env.robot
        if not robot:
            raise ConfigError("check needs task=<name> or robot=<name>, as in: roboverse check task=PickCube")
        ROBOTS.entry(robot)
        return f"robot {robot}", ROBOT_CONTRACTS, CheckedRobot(robot, config.env.simulator)
    if config.policy_name:
        from roboverse_learn.checks.policies import POLICY_CONTRACTS, CheckedPolicy
        from roboverse_learn.config.compose import compose

        words = [f"policy={config.policy_name}", f"preset={config.preset}"]
        settings = compose("train", words).policy
        checked = CheckedPolicy(config.policy_name, config.env, settings)
        return f"policy {config.policy_name} on {config.env.task}", POLICY_CONTRACTS, checked
    from roboverse_learn.checks.checked_task import CheckedTask
    from roboverse_learn.checks.tasks import TASK_CONTRACTS

    checked = CheckedTask(
        config.env, num_envs=config.num_envs, episodes=config.episodes, required=config.required
    )
    return f"task {config.env.task}", TASK_CONTRACTS, checked


@contextlib.contextmanager
def _closing(checked: Any) -> Iterator[None]:
    try:
        yield
    finally:
        if hasattr(checked, "close"):
            checked.close()


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("check")
