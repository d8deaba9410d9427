"""Keys of demonstrations beside a policy that learns without any."""

from collections.abc import Iterable

import policies
from envs.core.errors import ConfigError
from roboverse_learn.config.command_line_keys import typed_key

OF_DEMONSTRATIONS = (
    *("dataset", "collect.num_demos", "source", "checkpoint", "path", "replay", "only_corrections"),
    *("from_dataset", "collect.steps_per_look"),
)
"""Keys of ``train`` that say which demonstrations are learned from; keys ``augment.*`` do, too."""


def check_demonstration_keys(command: str, policy: str, keys: Iterable[str]) -> None:
    """Checks that no demonstrations are named for a policy that learns from its environment.

    PPO's ``policy.expert_starts`` asks the task's scripted expert, not a dataset.

    Args:
        command: Command of the keys; of others than ``train`` nothing is checked.
        policy: Its policy.
        keys: Full names of the keys that are given.

    Raises:
        ConfigError: One of them names demonstrations.
    """
    if command != "train" or policies.learns_from(policy) != "env":
        return
    given = [key for key in keys if key in OF_DEMONSTRATIONS or key.startswith("augment.")]
    if not given:
        return
    words = [f"{typed_key(key.removeprefix('collect.'))}=" for key in dict.fromkeys(given)]
    one = len(words) == 1
    raise ConfigError(
        f"{' and '.join(words)} {'chooses' if one else 'choose'} demonstrations, and policy={policy} learns "
        f"from its environment and reads none. Leave {'it' if one else 'them'} out, or take a policy that "
        f"learns from demonstrations: {', '.join(policies.names('dataset'))}."
    )
