"""Whether the validation split is new to a policy."""

from collections.abc import Collection

import policies
from envs.core.errors import ConfigError
from envs.randomization.splits import VALIDATION, episodes_before_validation


def check_validation(splits: Collection[str], policy: str, num_demos: int) -> None:
    """Checks that training leaves out the episodes of the validation split, if that is evaluated.

    Args:
        splits: Splits that are evaluated.
        policy: Name of the policy.
        num_demos: Demonstrations that are collected for it.

    Raises:
        ConfigError: Training may use them.
    """
    if VALIDATION not in splits:
        return
    most = len(episodes_before_validation())
    if policies.learns_from(policy) == "env":
        why = f"policy={policy} learns from every episode of the train split"
    elif num_demos > most:
        why = f"of num_demos={num_demos:,} more than {most:,} are of its episodes"
    else:
        return
    raise ConfigError(
        f"The validation split is of episodes that demonstrations leave out, and {why}. Leave {VALIDATION} "
        f"out of evaluate.splits{'' if num_demos <= most else f', or give num_demos={most} at most'}."
    )
