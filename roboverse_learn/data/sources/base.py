"""Interface of a source of demonstrations: its checks before a run, and its episodes."""

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from envs.core.errors import ConfigError, DatasetError
from envs.spec import EnvSpec
from roboverse_learn.config.command_line_keys import flat_keys, typed_key
from roboverse_learn.data.augmentation.config import AugmentConfig

if TYPE_CHECKING:
    from roboverse_learn.data.dataset.schema import EpisodeData

Progress = Callable[[str], AbstractContextManager[Callable[[int, int, str], None]]]
"""Shows a progress bar of a name; it yields a function of the number done, the number in all, and a text."""

_KEYS = {
    "path": "reads no file. Name its format, as in source=maniskill.",
    "checkpoint": "uses no policy. Add source=policy.",
    "from_dataset": "makes nothing from a dataset. Add source=augment, retarget or rerender.",
}
"""Keys that some sources need: what to say where they are given to another."""


class EpisodeSource(Protocol):
    """Runs episodes of a pool, in the processes of a collection."""

    def attempts(self, indices: Sequence[int]) -> "Iterator[tuple[int, EpisodeData | None]]":
        """Runs a batch of pool episodes.

        Yields:
            Each pool index once, in any order, with its episode, or with None where the demonstrator
            failed. The episode's ``metadata["episode"]`` is the pool index.
        """
        ...

    def close(self) -> None:
        """Releases the simulator."""
        ...


def spec_changes(env: EnvSpec) -> dict[str, Any]:
    """Returns another robot, changes of simulator and scene; a dataset without does not name them."""
    changes: dict[str, Any] = {
        "robot": env.robot,
        "simulator_settings": dict(env.simulator_settings),
        "scenario": dict(env.scenario),
    }
    return {key: values for key, values in changes.items() if values}


def imported(reference: str) -> Any:
    """Returns the class or function of a reference ``"package.module:name"``, importable in any process.

    Raises:
        DatasetError: There is no such class or function.
    """
    module, _, name = reference.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise DatasetError(
            f"No episode source '{reference}': {error}. Give 'package.module:Class'."
        ) from error


class DemonstrationSource:
    """One value of ``source=``, for one configuration. A subclass overrides what differs.

    Args:
        config: The configuration of ``roboverse collect``.

    Attributes:
        episodes: ``"package.module:Class"`` of its :class:`EpisodeSource`, which collecting processes make.
        needs: Keys of the configuration that must be given, to what they are, for a message.
        num_demos_is_most: Whether ``num_demos`` is only the most that is taken.
        augments: Whether it takes the keys ``augment.*``.
        corrects: Whether it takes ``only_corrections``.
        native_observations: Whether it also records another benchmark's observation of the task.
        changes_looks: Whether it takes ``collect.steps_per_look``.
        demonstrates: What demonstrates, for the report.
        columns: Further columns of its datasets: options of
            :func:`~roboverse_learn.data.dataset.schema.make_features`.
    """

    episodes: ClassVar[str]
    needs: ClassVar[Mapping[str, str]] = {}
    num_demos_is_most: ClassVar[bool] = False
    augments: ClassVar[bool] = False
    corrects: ClassVar[bool] = False
    native_observations: ClassVar[bool] = False
    changes_looks: ClassVar[bool] = False
    demonstrates: ClassVar[str] = "the expert"
    columns: ClassVar[tuple[str, ...]] = ()

    def __init__(self, config: Any) -> None:
        self.config = config

    @classmethod
    def check_keys(cls, config: Any) -> None:
        """Checks which keys are given.

        Raises:
            ConfigError: One is missing, or is not for this source.
        """
        for key, advice in _KEYS.items():
            given, word = getattr(config, key), typed_key(key)
            if given and key not in cls.needs:
                raise ConfigError(f"{word}={given} was given, and source={config.source} {advice}")
            if key in cls.needs and not given:
                raise ConfigError(f"source={config.source} needs {word}={cls.needs[key]}")
        if config.augment != AugmentConfig() and not cls.augments:
            raise ConfigError(
                f"Keys augment.* were given, and source={config.source} takes none. Add source=augment."
            )
        if config.only_corrections and not cls.corrects:
            raise ConfigError(
                f"only_corrections=true was given, and source={config.source} has none. Add source=teleop."
            )
        if config.collect.steps_per_look and not cls.changes_looks:
            steps = config.collect.steps_per_look
            raise ConfigError(
                f"steps_per_look={steps} was given, and source={config.source} keeps the looks of its "
                "episodes. Leave it out, and render its dataset again: "
                f"source=rerender from=<its dataset> steps_per_look={steps}."
            )

    @classmethod
    def task_of(cls, values: Mapping[str, Any]) -> str | None:
        """Returns the task where the command line names none.

        Args:
            values: The configuration as plain values.
        """
        return values["task"]

    def check(self) -> None:
        """Checks before a run whether there is something to collect from.

        Raises:
            ConfigError: There is not, for this task.
        """

    def prepare(self, dataset: Path, progress: Progress) -> None:
        """Prepares the source before the first episode.

        Args:
            dataset: Folder of the dataset, which may not exist yet.
            progress: Shows a progress bar.
        """

    def count_part(self) -> str:
        """Returns what the name of the dataset's folder says about the number of demonstrations."""
        return f"{self.config.collect.num_demos}demos"

    def name_part(self) -> str:
        """Returns the source's part of the name of the dataset's folder."""
        return ""

    def settings(self) -> dict[str, Any]:
        """Returns the settings of the dataset, which one that is continued must share; JSON values."""
        env = self.config.env
        keys = ("task", "task_kwargs", "level", "only", "simulator", "renderer", "cameras", "image_size")
        scene = {key: getattr(env, key) for key in keys} | {"materials": env.materials or None}
        return scene | spec_changes(env) | self.identity() | self._looks_arguments()

    def identity(self) -> dict[str, Any]:
        """Returns the part of the settings that names the demonstrator; JSON values."""
        return {}

    def arguments(self) -> dict[str, Any]:
        """Returns the arguments of :attr:`episodes`; JSON values."""
        collect = self.config.collect
        return {"env": self.config.env.to_json(), "num_envs": collect.num_envs} | self._looks_arguments()

    def _looks_arguments(self) -> dict[str, int]:
        """Returns how long a look stays; nothing where it stays for the whole episode."""
        steps = self.config.collect.steps_per_look
        return {"steps_per_look": steps} if steps else {}

    def candidates(self) -> list[int]:
        """Returns the episodes of the train split that are tried, in this order.

        Those of the validation split are among them only where the others cannot be enough.
        """
        from envs.randomization.splits import episodes_before_validation, load_split

        others = episodes_before_validation()
        enough = self.config.collect.num_demos <= len(others)
        return (others if enough else load_split("train").episodes).tolist()

    def advice(self) -> str:
        """Says what to change where too few episodes succeed."""
        env, usual = self.config.env, EnvSpec()
        named = ("level", "only", "robot", "simulator")
        keys = [key for key in named if getattr(env, key) != getattr(usual, key)]
        for section in ("task_kwargs", "simulator_settings", "scenario"):
            keys += flat_keys(getattr(env, section), f"{section}.")
        if keys:
            return f"Leave out, or make easier, what differs from the task's own scene: {', '.join(keys)}."
        return self.advice_for_task()

    def advice_for_task(self) -> str:
        """Says what to do where too few episodes succeed in the task's own scene."""
        return "Give a smaller num_demos."

    def outcome(self, num_kept: int, num_attempts: int) -> str:
        """Says how often the demonstrator succeeded, for the report."""
        share = 100 * num_kept / max(num_attempts, 1)
        return f"{self.demonstrates} succeeded in {share:.1f} % of {num_attempts} episodes"

    def finish(self, dataset: Path) -> Any:
        """Adds the source's own data to a complete dataset; returns it for the report, or None."""
        del dataset
