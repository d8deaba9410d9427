"""The scene in which episodes were recorded, and whether another environment has the same one."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError, DatasetError
from envs.spec import EnvSpec
from roboverse_learn.config.command_line_keys import at, flat_keys
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.recording import RecordingReader
from roboverse_learn.data.dataset.schema import INFO_PATH

_SCENE = ("task", "task_kwargs", "scenario")


def task_of(root: str | Path) -> str | None:
    """Returns the task that a dataset's demonstrations are of; None where it does not say or is absent."""
    if not (Path(root) / INFO_PATH).exists():
        return None
    metadata = DatasetInfo.open(root).episode_metadata
    return metadata[0].get("task") if metadata else None


def check_not_merged(folder: str | Path, facts: Iterable[Mapping[str, Any]]) -> None:
    """Checks that episodes are of one task and of one robot.

    Args:
        folder: The dataset, for the message.
        facts: Metadata of its episodes.

    Raises:
        ConfigError: They are of several.
    """
    facts = list(facts)
    for key in ("task", "robot"):
        examples = {each.get(key) or "": each for each in facts}
        if len(examples) < 2:
            continue
        # Episodes of the task's own robot do not name it.
        own = {"task": lambda _: "one without a name", "robot": robot_of}[key]
        names = sorted({value or own(each) for value, each in examples.items()})
        if len(names) > 1:
            raise ConfigError(
                f"The dataset '{folder}' has episodes of several {key}s ({', '.join(names)}). Give the "
                "datasets that it was merged of, one by one."
            )


def what_to_give(key: str, recorded: str) -> str:
    """Says, for a message, what to give where an environment is another one than was recorded.

    Args:
        key: What differs, ``"task"`` or ``"robot"``.
        recorded: Its value in the recording; empty for the task's own robot.
    """
    return f"give {key}={recorded}" if recorded else f"leave out {key}="


def check_same_scene(
    folder: str, recorded: Mapping[str, Any], env: EnvSpec, keys: tuple[str, ...] = _SCENE
) -> None:
    """Checks that an environment has the scene of recorded states.

    Args:
        folder: The dataset, for the message.
        recorded: Metadata of one of its episodes.
        env: The environment.
        keys: Fields of the environment that must be the same.

    Raises:
        ConfigError: One differs.
    """
    for key in keys:
        was, wanted = (_words(key, value or {}) for value in (recorded.get(key), getattr(env, key)))
        if was != wanted:
            raise ConfigError(
                f"The dataset '{folder}' was recorded with {was}, and {wanted} was requested. Its states "
                f"belong to their own scene alone: {_advice(folder, key, recorded, env)}"
            )


def _advice(folder: str, key: str, recorded: Mapping[str, Any], env: EnvSpec) -> str:
    """Returns what to give in place of a field that differs."""
    if key == "task" and recorded.get("task"):
        return f"{what_to_give(key, recorded['task'])}."
    if key != "robot":
        return "give what they were recorded with."
    own = what_to_give(key, recorded.get("robot") or "")
    other = env.make_task().robot.name
    return f"{own}. For demonstrations of '{other}': source=retarget from={folder} robot={other}."


def _words(key: str, value: Any) -> str:
    """Returns a field of the environment as it is typed."""
    if key == "robot" and not value:
        return "the task's own robot"
    if isinstance(value, str):
        return f"{key}={value}"
    keys = flat_keys(value, f"{key}.")
    return " ".join(f"{name}={at({key: value}, name)}" for name in sorted(keys)) or f"no {key}"


def recorded_spec(recorded: Mapping[str, Any]) -> EnvSpec:
    """Returns the environment whose robot was recorded, from an episode's metadata."""
    keys = (*_SCENE, "robot")
    return EnvSpec.from_json({key: recorded[key] for key in keys if recorded.get(key)})


def robot_of(recorded: Mapping[str, Any]) -> str:
    """Returns the name of the robot that was recorded, also of the task's own, which episodes do not name."""
    return recorded_spec(recorded).make_task().robot.name


def pool_indices(recordings: RecordingReader) -> list[int]:
    """Returns the pool index of each recorded episode, in the order of the dataset.

    Raises:
        DatasetError: An episode is of the test split or of no pool, or two have one index.
    """
    facts = recordings.info.episode_metadata
    where = f"The dataset '{recordings.info.root}'"
    for number, metadata in enumerate(facts):
        if metadata.get("split") != "train" or "episode" not in metadata:
            raise DatasetError(
                f"{where} has an episode ({number}) that is not of the train split. Give a dataset that "
                "roboverse collect made."
            )
    own = [int(metadata["episode"]) for metadata in facts]
    if len(set(own)) < len(own):
        raise DatasetError(
            f"{where} has several episodes of one index of the pool: it is merged, or rendered again "
            "itself. Give the datasets that it was made of, one by one."
        )
    return own
