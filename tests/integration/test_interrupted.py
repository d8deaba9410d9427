"""``train.py`` killed in every stage: the same command finishes the same run."""

import json
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from benchmark.records import EpisodeRecord
from benchmark.results import read_result
from envs.core.fingerprint import file_hash
from policies.checkpoint import WEIGHTS
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.training.metrics import read_metrics
from tests import imported_process
from tests.integration.main_run import TINY, MainRun

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "roboverse_learn/train.py"
LOSSES = ("step", "loss", "lr", "grad_norm")

COMMITS_EACH_ALONE = f"""
import functools, runpy, sys
from roboverse_learn.data.collection import pool
pool.together = functools.partial(pool.together, within_s=0.0)
sys.argv[0] = {str(SCRIPT)!r}
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""The command, which commits no episodes together: a fast machine has all of them within that second."""


class Interrupted:
    """The main command in a folder of its own, killed in each stage and then left to finish.

    Attributes:
        folder: The folder.
        found: What lay there after each kill, by stage.
        code: Exit code of the last start.
        log: What the last start printed.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.found: dict[str, dict[str, object]] = {}
        self._kill("collect", self._first_episode_is_committed, COMMITS_EACH_ALONE)
        self._kill("train", self._first_checkpoint_is_written)
        self._kill("evaluate", self._first_cell_is_evaluated)
        process = self._start()
        process.join(timeout=300)
        self.code = process.exitcode
        self.log = self._log.read_text()

    @property
    def _log(self) -> Path:
        return self.folder / "log.txt"

    def _start(self, program: Path | str = SCRIPT) -> BaseProcess:
        return imported_process.start(program, *TINY, folder=self.folder, out=self._log)

    def _kill(self, stage: str, reached: Callable[[], bool], program: Path | str = SCRIPT) -> None:
        """Starts the command and kills it as soon as ``reached`` says so."""
        process = self._start(program)
        until = time.monotonic() + 240
        while not reached():
            assert process.is_alive(), f"ended before the kill in {stage}: {self._log.read_text()}"
            assert time.monotonic() < until, f"{stage} was not reached: {self._log.read_text()}"
            time.sleep(0.01)
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        (run,) = (self.folder / "runs/PickCube/act").iterdir()
        manifest = json.loads((run / "manifest.json").read_text())
        self.found[stage] = {
            "running": [name for name, facts in manifest["stages"].items() if facts["status"] == "running"],
            "episodes": len(list(self.folder.glob("datasets/PickCube/*/raw/episode_*.safetensors"))),
            "steps": [row["step"] for row in read_metrics(run)],
            "results": list(self.folder.glob("results/**/[!.]*.json")),
        }

    def _first_episode_is_committed(self) -> bool:
        return any(self.folder.glob("datasets/PickCube/*/raw/episode_000000.safetensors"))

    def _first_checkpoint_is_written(self) -> bool:
        return any(self.folder.glob("runs/PickCube/act/*/checkpoints/000004"))

    def _first_cell_is_evaluated(self) -> bool:
        return any(self.folder.glob("results/v2/PickCube/act/.*.cells.json"))


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Interrupted:
    """Kills the main command three times, and lets the fourth start finish."""
    return Interrupted(tmp_path_factory.mktemp("interrupted"))


def test_every_kill_came_in_the_middle_of_its_stage(interrupted: Interrupted) -> None:
    collect, train, evaluate = (interrupted.found[name] for name in ("collect", "train", "evaluate"))
    assert collect["running"] == ["collect"] and 1 <= collect["episodes"] < 4
    assert train["running"] == ["train"] and train["episodes"] == 4
    assert train["steps"][-1] < 12
    assert evaluate["running"] == ["evaluate"] and evaluate["steps"][-1] == 12
    assert evaluate["results"] == []  # a results file is whole, or is not there


def test_the_same_command_finishes(interrupted: Interrupted) -> None:
    assert interrupted.code == 0, interrupted.log
    assert "level 3" in interrupted.log and "Traceback" not in interrupted.log
    assert "Evaluated before: level 0, test split" in interrupted.log
    assert "level 0, test split: " not in interrupted.log  # a finished cell is not evaluated again
    assert not any(interrupted.folder.glob("results/**/.*.json"))
    run = MainRun.at(interrupted.folder).run
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["status"] == "done" and len(manifest["starts"]) == 4
    assert {facts["status"] for facts in manifest["stages"].values()} == {"done"}


def test_the_dataset_is_that_of_a_run_without_a_kill(interrupted: Interrupted, main_run: MainRun) -> None:
    after = MainRun.at(interrupted.folder)
    hashes = {read_facts(run, "collect")["dataset_hash"] for run in (after.run, main_run.run)}
    assert len(hashes) == 1


def test_the_losses_and_weights_are_those_of_a_run_without_a_kill(
    interrupted: Interrupted, main_run: MainRun
) -> None:
    after = MainRun.at(interrupted.folder)
    killed, whole = (
        [{key: row[key] for key in LOSSES} for row in read_metrics(run)] for run in (after.run, main_run.run)
    )
    assert killed == whole
    assert [row["step"] for row in whole] == list(range(1, 13))
    assert file_hash(after.checkpoint / WEIGHTS) == file_hash(main_run.checkpoint / WEIGHTS)


def test_the_episodes_are_those_of_a_run_without_a_kill(interrupted: Interrupted, main_run: MainRun) -> None:
    def timeless(record: EpisodeRecord) -> EpisodeRecord:
        return replace(record, wall_time_s=0.0)

    killed, whole = (
        [timeless(record) for record in read_result(path).records]
        for path in (MainRun.at(interrupted.folder).result, main_run.result)
    )
    assert killed == whole


def test_no_temporary_file_is_left(interrupted: Interrupted) -> None:
    names = {path.name for path in interrupted.folder.rglob("*")}
    leftovers = [name for name in names if name.startswith(".") and name != ".lock"]
    assert leftovers == []
