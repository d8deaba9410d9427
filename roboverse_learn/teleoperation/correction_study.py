"""Corrections of a policy against as many plain demonstrations: rounds of DAgger (arXiv:1011.0686).

``python -m roboverse_learn.teleoperation.correction_study task=PickCube level=3 start=200 per_round=100``
trains a policy on ``start`` demonstrations of the expert. In each round the policy acts in ``per_round`` more
episodes, the expert takes over where it strays, and a policy is trained on the demonstrations and all
corrections so far. Beside it, policies learn from as many demonstrations that the expert made alone. Every
policy is evaluated where it was trained; the page of studies draws both lines.

Keys that are none of the program's are those of ``roboverse train``, the same for every policy. The same
command continues a study that was stopped.
"""

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from envs.core.arguments import parse
from envs.core.errors import RoboVerseError
from envs.core.ranges import check_ranges
from roboverse_learn.collect import collect_dataset
from roboverse_learn.commands.called_with import called_with
from roboverse_learn.config.compose import compose
from roboverse_learn.data.dataset.merge import merge
from roboverse_learn.teleoperate import teleoperate
from roboverse_learn.train import train_run

logger = logging.getLogger(__name__)

_COMMAND = "python -m roboverse_learn.teleoperation.correction_study"

CORRECTIONS, PLAIN = "corrections", "plain"
"""Names of the datasets, by which the results call them: every round's folder has both."""


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """Settings of the study.

    Attributes:
        task: Registered task whose hand can be steered.
        level: Randomization level of training and test.
        policy: Registered policy that learns from demonstrations.
        preset: Preset of the training.
        start: Demonstrations that the first policy learns from.
        per_round: Corrections, and plain demonstrations, of each round.
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
    """

    def __init__(self, settings: StudySettings, more: Sequence[str] = ()) -> None:
        self._settings, self._more = settings, tuple(more)
        compose("train", [*self._words(), *more])  # a wrong word fails before the first collection

    def run(self) -> list[tuple[int, float, float]]:
        """Does what is missing; returns per round its demonstrations, and successes in % of both policies."""
        settings, rows = self._settings, []
        first = self._expert(0, CORRECTIONS)
        checkpoint, corrected = self._trained(0, first)
        rows.append((settings.start, corrected, corrected))
        for number in range(1, settings.rounds + 1):
            made = self._corrections(number, checkpoint)
            checkpoint, corrected = self._trained(number, self._merged(number, CORRECTIONS, [first, made]))
            _, plain = self._trained(number, self._expert(number, PLAIN))
            rows.append((settings.start + number * settings.per_round, corrected, plain))
        return rows

    def _words(self) -> list[str]:
        settings = self._settings
        return [f"{key}={getattr(settings, key)}" for key in ("task", "level", "preset", "policy")]

    def _folder(self, number: int, name: str) -> Path:
        return self._settings.out / f"round{number}" / name

    def _expert(self, number: int, name: str) -> Path:
        """Collects the plain demonstrations of a round, those of earlier rounds among them."""
        count = self._settings.start + number * self._settings.per_round
        config = compose("train", [*self._words(), *self._more, f"num_demos={count}"])
        words = [f"task={config.env.task}", f"level={config.env.level}", f"num_demos={count}"]
        words += [f"image_size={config.env.image_size}", f"cameras=[{','.join(config.env.cameras)}]"]
        words += [f"simulator={config.env.simulator}", f"num_workers={config.collect.num_workers}"]
        folder = self._folder(number, name)
        collect_dataset(compose("collect", [*words, f"dataset={folder}"]))
        return folder

    def _corrections(self, number: int, checkpoint: Path) -> Path:
        """Lets the policy act and the expert correct it; returns the dataset of all corrections so far."""
        settings, recordings = self._settings, self._settings.out / "recordings"
        count = number * settings.per_round
        words = [f"task={settings.task}", f"level={settings.level}", f"checkpoint={checkpoint}"]
        words += ["actor=expert", f"num_demos={count}", f"recordings={recordings}", "render=false"]
        teleoperate(compose("teleoperate", words))
        env = compose("train", [*self._words(), *self._more]).env
        words = [f"task={settings.task}", f"level={settings.level}", "source=teleop", f"path={recordings}"]
        words += [f"image_size={env.image_size}", f"cameras=[{','.join(env.cameras)}]", f"num_demos={count}"]
        folder = self._folder(number, "corrections-alone")
        collect_dataset(compose("collect", [*words, "only_corrections=true", f"dataset={folder}"]))
        return folder

    def _merged(self, number: int, name: str, parts: Sequence[Path]) -> Path:
        folder = self._folder(number, name)
        merge(parts, folder)
        return folder

    def _trained(self, number: int, dataset: Path) -> tuple[Path, float]:
        """Trains and evaluates a policy; returns its run, and its successes at the level of training in %."""
        words = [*self._words(), f"dataset={dataset}", f"evaluate.levels=[{self._settings.level}]"]
        words += ["evaluate.splits=[test]", *self._more]
        config = compose("train", words)
        name = f"study-level{config.env.level}-seed{config.seed}-{dataset.name}-round{number}"
        words.append(f"run={Path(config.runs_dir) / config.env.task / config.policy_name / name}")
        with called_with(words):
            run = train_run(compose("train", words))
        assert run is not None, "one process alone runs a study"
        (cell,) = run.evaluations[0].result.cells()
        return run.folder, 100.0 * cell.success_rate


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
