"""Corrections of a policy against as many plain demonstrations: rounds of DAgger (arXiv:1011.0686).

``python -m roboverse_learn.teleoperation.correction_study task=PickCube level=3 start=200 per_round=100``
trains a policy on ``start`` demonstrations of the expert. In each round the policy acts in ``per_round`` more
episodes, the expert takes over where it strays, and a policy is trained on the demonstrations and all
corrections so far. Beside it, policies learn from as many demonstrations that the expert made alone. Every
policy is evaluated where it was trained: at its level, or with ``level=0 only=<channel>`` where that channel
varies alone. Of a level the page of studies draws both lines. An episode that the policy solves alone is no
correction, so a round may add fewer than ``per_round``, to both sides alike; a round without any keeps the
policies of the round before.

Keys that are none of the program's are those of ``roboverse train``, the same for every collection and
policy. The same command continues a study that was stopped; another study takes another folder ``out``.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from benchmark.protocol import Cell
from envs.core.arguments import parse
from envs.core.atomic import write_json
from envs.core.errors import ConfigError, RoboVerseError
from envs.core.fingerprint import digest
from envs.core.ranges import check_ranges
from envs.randomization.levels import channels_of
from envs.spec import EnvSpec
from roboverse_learn.collect import collect_dataset
from roboverse_learn.commands.called_with import called_with
from roboverse_learn.commands.run_identity import identity
from roboverse_learn.commands.scene_labels import varied_part
from roboverse_learn.config.compose import compose
from roboverse_learn.config.schema import CollectConfig, EvaluationConfig, TeleoperateConfig, TrainRunConfig
from roboverse_learn.data.collection.schedule import check_settings
from roboverse_learn.data.dataset.damage import read_json
from roboverse_learn.data.dataset.merge import merge
from roboverse_learn.teleoperate import teleoperate
from roboverse_learn.teleoperation.recording import Mark, Recording, open_recordings
from roboverse_learn.train import train_run

logger = logging.getLogger(__name__)

_COMMAND = "python -m roboverse_learn.teleoperation.correction_study"

CORRECTIONS, PLAIN = "corrections", "plain"
"""Names of the datasets, by which the results call them: every round's folder has both."""


_OWN = {
    "levels": "every policy is tested at the level that it is trained at; give level=<level>",
    "splits": "every policy is tested on the test split; leave it out",
    "dataset": "it makes its datasets itself; give out=<folder> for all of them",
    "run": "every policy has a run of its own; give runs_dir=<folder> for all of them",
    "num_demos": "give start=<number> and per_round=<number>",
    "source": "the task's expert demonstrates and corrects; leave it out",
}
"""Keys of ``roboverse train`` that the study sets itself, with what to give instead."""


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """Settings of the study.

    Attributes:
        task: Registered task whose hand can be steered.
        level: Randomization level of training and test.
        policy: Registered policy that learns from demonstrations.
        preset: Preset of the training.
        start: Demonstrations that the first policy learns from.
        per_round: Episodes of each round; as many plain demonstrations are added as were corrected.
        rounds: Rounds.
        out: Folder of datasets and recordings.
    """

    task: str = "PickCube"
    level: int = 3
    policy: str = "act"
    preset: str = "quick"
    start: int = 200
    per_round: int = 100
    rounds: int = 3
    out: Path = Path("datasets/corrections")

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("start", "per_round", "rounds"))


class CorrectionStudy:
    """The rounds of one study.

    Args:
        settings: See :class:`StudySettings`.
        more: Further words of ``roboverse train``.

    Raises:
        ConfigError: A word is wrong, or sets what the study sets itself.
    """

    def __init__(self, settings: StudySettings, more: Sequence[str] = ()) -> None:
        _refuse_own(more)
        self._settings = settings
        names = ("task", "level", "preset", "policy")
        words = [*(f"{name}={getattr(settings, name)}" for name in names), *more]
        start = f"num_demos={settings.start}"
        given: TrainRunConfig = compose("train", [*words, start])
        self._cell = _cell_of(given.env)
        self._words = [*words, *_evaluation_words(self._cell, given.evaluate)]
        self._config: TrainRunConfig = compose("train", [*self._words, start])
        # Too many demonstrations fail before the first collection, like a wrong word.
        self._collect_config(self._folder(0, PLAIN), settings.start + settings.rounds * settings.per_round)

    def run(self) -> list[tuple[int, float, float]]:
        """Does what is missing; returns per round its demonstrations, and successes in % of both policies.

        Raises:
            DatasetError: The folder ``out`` holds another study.
        """
        self._refuse_other_study()
        count, num_corrections = self._settings.start, 0
        first = self._expert(0, CORRECTIONS, count)
        checkpoint, corrected = self._trained(0, first)
        plain = corrected
        rows = [(count, corrected, plain)]
        for number in range(1, self._settings.rounds + 1):
            before, num_corrections = num_corrections, self._corrected(number, checkpoint)
            if num_corrections == before:
                logger.info("Round %d: the policy needed no correction; its demonstrations stay.", number)
            else:
                merged = self._folder(number, CORRECTIONS)
                count = merge([first, self._corrections(number, num_corrections)], merged).num_episodes
                checkpoint, corrected = self._trained(number, merged)
                _, plain = self._trained(number, self._expert(number, PLAIN, count))
            rows.append((count, corrected, plain))
        return rows

    @property
    def _recordings(self) -> Path:
        return self._settings.out / "recordings"

    def _folder(self, number: int, name: str) -> Path:
        return self._settings.out / f"round{number}" / name

    def _identity(self) -> dict[str, Any]:
        """Returns what decides the demonstrations and policies of a round, as JSON values."""
        return identity(self._config) | {"per_round": self._settings.per_round}

    def _refuse_other_study(self) -> None:
        """Writes once what the study is: another one in its folder would mix with its datasets."""
        path = self._settings.out / "study.json"
        if path.exists():
            check_settings(self._settings.out, read_json(path), self._identity())
        else:
            write_json(path, self._identity())

    def _collect_config(self, folder: Path, count: int, **source: Any) -> CollectConfig:
        """Returns the configuration of a collection, in the environment of training."""
        collect = replace(self._config.collect, num_demos=count)
        return CollectConfig(env=self._config.env, collect=collect, dataset=str(folder), **source)

    def _expert(self, number: int, name: str, count: int) -> Path:
        """Collects the plain demonstrations of a round, those of earlier rounds among them."""
        folder = self._folder(number, name)
        collect_dataset(self._collect_config(folder, count))
        return folder

    def _corrected(self, number: int, checkpoint: Path) -> int:
        """Lets the policy act and the expert correct it; returns the number of corrections so far.

        Rounds share a folder of recordings, so that each has other episodes. Where a study is continued,
        those of later rounds do not count.
        """
        count = number * self._settings.per_round
        teleoperate(
            TeleoperateConfig(
                env=self._config.env,
                checkpoint=str(checkpoint),
                device=self._config.device,
                actor="expert",
                num_demos=count,
                recordings=str(self._recordings),
                render=False,
            )
        )
        facts = open_recordings(self._recordings)
        solved = [path for path in facts if facts[path]["mark"] == Mark.SUCCESS]
        return sum(Recording.read(path).taken_over is not None for path in solved[:count])

    def _corrections(self, number: int, count: int) -> Path:
        """Renders the first ``count`` corrections; returns their dataset."""
        folder = self._folder(number, "corrections-alone")
        source: dict[str, Any] = {"source": "teleop", "path": str(self._recordings), "only_corrections": True}
        collect_dataset(self._collect_config(folder, count, **source))
        return folder

    def _trained(self, number: int, dataset: Path) -> tuple[Path, float]:
        """Trains and evaluates a policy; returns its run, and its successes where it was trained in %."""
        config = self._config
        name = f"study-{varied_part(config.env)}-seed{config.seed}-{dataset.name}-round{number}"
        folder = Path(config.runs_dir) / config.env.task / config.policy_name
        run_folder = folder / f"{name}-{digest(self._identity())}"
        words = [*self._words, f"dataset={dataset}", f"run={run_folder}"]
        with called_with(words):
            run = train_run(compose("train", words))
        assert run is not None, "one process alone runs a study"
        (tested,) = (each for each in run.evaluations[0].result.cells() if each.cell == self._cell)
        return run.folder, 100.0 * tested.success_rate


def _cell_of(env: EnvSpec) -> Cell:
    """Returns the cell of the test split in which varies what varied in training."""
    if env.only is None or env.channels == channels_of(0):  # the task alone is level 0
        return Cell(level=env.level, split="test")
    return Cell(only=env.only, split="test")


def _evaluation_words(cell: Cell, given: EvaluationConfig) -> list[str]:
    """Returns the words of an evaluation of one cell, beside the channels and instructions that are given."""
    levels = [] if cell.level is None else [cell.level]
    if given.instructions and 0 not in levels:
        levels = [0, *levels]  # with which instructions are compared
    alone = [*dict.fromkeys(filter(None, [cell.only, *given.alone]))]
    words = {"levels": levels, "alone": alone, "splits": [cell.split]}
    return [f"evaluate.{key}=[{','.join(map(str, value))}]" for key, value in words.items()]


def _refuse_own(words: Sequence[str]) -> None:
    """Refuses words that set what the study sets itself.

    Raises:
        ConfigError: There is one.
    """
    for word in words:
        key = word.partition("=")[0]
        if advice := _OWN.get(key.removeprefix("evaluate.").removeprefix("collect.")):
            raise ConfigError(f"{word} is not for a study: {advice}.")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the study and prints a line per round; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    own = {item.name for item in fields(StudySettings)}
    is_own = [word.partition("=")[0] in own or word == "--help" for word in words]
    try:
        settings = parse(_COMMAND, StudySettings, [w for w, mine in zip(words, is_own, strict=True) if mine])
        more = [word for word, mine in zip(words, is_own, strict=True) if not mine]
        rows = CorrectionStudy(settings, more).run()
    except RoboVerseError as error:
        logger.error("%s", error)
        return 2
    for count, corrected, plain in rows:
        logger.info("%5d demonstrations: %5.1f %% with corrections, %5.1f %% plain", count, corrected, plain)
    return 0


if __name__ == "__main__":
    sys.exit(main())
