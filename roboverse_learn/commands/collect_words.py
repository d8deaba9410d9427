"""A configuration as the words of ``roboverse collect``."""

from roboverse_learn.config.command_line_keys import flat_keys
from roboverse_learn.config.schema import CollectConfig
from roboverse_learn.config.serialize import to_values
from roboverse_learn.config.value_text import as_text


def collect_words(config: CollectConfig) -> list[str]:
    """Returns the words of ``roboverse collect`` that compose to a configuration.

    Args:
        config: The configuration; of a run, what belongs to training is passed over.

    Returns:
        ``key=value`` for each value that is not the default. A shell needs them quoted.
    """
    values, defaults = to_values(config), to_values(CollectConfig())
    words = []
    for key in flat_keys(defaults):
        if key == "preset":  # what it says, and what overrides it, follows by itself
            continue
        section, _, last = key.rpartition(".")
        value = values[section][last] if section else values[key]
        default = defaults[section][last] if section else defaults[key]
        if isinstance(value, dict):
            words += [f"{key}.{name}={as_text(item)}" for name, item in value.items()]
        elif value != default:
            words.append(f"{key}={value if isinstance(default, str) else as_text(value)}")
    return words
