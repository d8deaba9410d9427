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
        The task, and ``key=value`` for each value that is not the default. A shell needs them quoted.
    """
    return _words("collect", config)


def evaluate_words(config: EvaluateConfig) -> list[str]:
    """Returns the words of ``roboverse evaluate`` that compose to it, as :func:`collect_words` does."""
    return _words("evaluate", config)


def _words(command: str, config: CollectConfig | EvaluateConfig) -> list[str]:
    values, defaults = to_values(config), default_values(command, "")
    if not config.suite:
        defaults["task"] = ""  # without the word, a source takes the task of its recordings
    given, words = set(flat_keys(values)), []
    for key in flat_keys(defaults):
        value, default = at(values, key), at(defaults, key)
        # What a preset says, and what overrides it, follows by itself.
        if key == "preset" or key not in given or value == default:
            continue
        if key in OPEN:
            words += [f"{key}.{name}={as_text(item)}" for name, item in value.items()]
        else:
            words.append(f"{typed_key(key)}={value if isinstance(default, str) else as_text(value)}")
    return words
