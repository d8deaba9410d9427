"""Checks of ``suite=`` and ``chains=`` beside other keys."""

from collections.abc import Iterable

from envs.core.errors import ConfigError
from envs.tasks.calvin.sequences import NUM_CHAINS
from envs.tasks.suites import suite_tasks

OF_CHAINS = ("evaluate.num_envs", "evaluate.other_tasks")
"""Keys of an evaluation that chains have, too."""


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


def check_chains(suite: str, chains: int, first: int) -> None:
    """Checks that chains are of CALVIN's suite, and that there are so many.

    Raises:
        ConfigError: They are not.
    """
    if (chains or first) and suite != "calvin":
        raise ConfigError(f"Chains of instructions are CALVIN's: give chains={chains} suite=calvin.")
    if first and not chains:
        raise ConfigError(f"first_chain={first} needs chains=<how many>.")
    if chains and not (0 <= first < NUM_CHAINS and 1 <= chains <= NUM_CHAINS - first):
        raise ConfigError(
            f"chains and first_chain name some of the {NUM_CHAINS:,} chains, counted from 0: chains is from "
            f"1 to {NUM_CHAINS - max(first, 0):,}, given {chains:,}, first_chain={first}."
        )


def check_keys_of_chains(chains: bool, keys: Iterable[str]) -> None:
    """Checks that nothing is given that chains of instructions decide themselves.

    Args:
        chains: Whether chains are evaluated; else everything may be given.
        keys: Dotted keys that are given beside them.

    Raises:
        ConfigError: One of them is of single tasks.
    """
    for key in keys if chains else ():
        if key.startswith("evaluate.") and key not in OF_CHAINS:
            raise ConfigError(
                f"{key} is of single tasks, and a chain has its own start and instructions: leave {key} or "
                "chains out."
            )
