"""Checks of ``suite=`` beside other keys."""

from envs.core.errors import ConfigError
from envs.tasks.suites import suite_tasks


def check_suite(suite: str, **others: str) -> None:
    """Checks that a suite exists, and that nothing else is given that is of one task.

    Args:
        suite: Name of the suite; empty checks nothing.
        **others: Keys that name one task, or what belongs to one, and their values.

    Raises:
        UnknownNameError: There is no such suite.
        ConfigError: One of the others is given, too.
    """
    if not suite:
        return
    suite_tasks(suite)
    for key, value in others.items():
        if value and key == "dataset":
            raise ConfigError(
                f"dataset={value} is one folder, and suite={suite} has a dataset for each task. Give "
                "datasets_dir=<folder>, which gets a folder for each."
            )
        if value:
            raise ConfigError(f"{key}={value} and suite={suite} are both given: leave one out.")


def refuse_suite_of_training(suite: str) -> None:
    """Says how the tasks of a suite are learned, where one run of ``train`` is to learn them.

    Raises:
        ConfigError: A suite is given.
    """
    if suite:
        raise ConfigError(
            f"suite={suite} has several tasks, and this policy learns one. A run for each: roboverse sweep "
            f"suite={suite}. One policy for all: policy=mtact suite={suite}, by their instructions; with "
            "reinforcement learning policy=tdmpc2."
        )
