"""A configuration as the words of ``roboverse collect`` or ``roboverse evaluate``."""

from roboverse_learn.config.command_line_keys import OPEN, at, flat_keys, typed_key
from roboverse_learn.config.schema import CollectConfig, EvaluateConfig
from roboverse_learn.config.serialize import default_values, to_values
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
        if key == "task" and not config.suite:  # without it a source takes the task of its recordings
            words.append(f"task={values[key]}")
            continue
        section, _, last = key.rpartition(".")
        value = values[section][last] if section else values[key]
        default = defaults[section][last] if section else defaults[key]
        if isinstance(value, dict):
            words += [f"{key}.{name}={as_text(item)}" for name, item in value.items()]
        elif value != default:
            words.append(f"{key}={value if isinstance(default, str) else as_text(value)}")
    return words


def evaluate_words(config: EvaluateConfig) -> list[str]:
    """Returns the words of ``roboverse evaluate`` that compose to it, as :func:`collect_words` does."""
    values, defaults = to_values(config), default_values("evaluate", "")
    words = []
    for key in flat_keys(values):
        value, default = at(values, key), at(defaults, key)
        if key == "preset" or value == default:
            continue
        if key in OPEN:
            words += [f"{key}.{name}={as_text(item)}" for name, item in value.items()]
        else:
            words.append(f"{typed_key(key)}={value if isinstance(default, str) else as_text(value)}")
    return words
