"""Flipped and cut bytes in checkpoints, datasets and results: an error that names the file, or no harm."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import policies
from benchmark.results import read_result
from envs.core.errors import RoboVerseError
from roboverse_learn.data import DatasetWriter, ResidentDataset, dataset_hash
from tests.policies.examples import make
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SHORT, WHOLE = 12, 34
"""Files of each kind: in every run of the tests, and with ``-m long``; three kinds make a hundred."""


def corrupt(folder: Path, number: int) -> str:
    """Flips, cuts, empties or replaces one file of a folder, by a seed; returns what was done."""
    rng = random.Random(number)
    path = rng.choice(sorted(each for each in folder.rglob("*") if each.is_file() and each.name != ".lock"))
    content = bytearray(path.read_bytes())
    kind = rng.choice(("flip", "flip", "flips", "cut", "empty", "html", "pickle"))
    if kind in ("flip", "flips"):
        for _ in range(1 if kind == "flip" else 20):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del content[rng.randrange(len(content)) :]
    else:
        replaced = {"empty": b"", "html": b"<html></html>", "pickle": b"cos\nsystem\n(S'touch ran'\ntR."}
        content = bytearray(replaced[kind])
    path.write_bytes(content)
    return f"{number}: {kind} of {path.relative_to(folder)}"


def read_checkpoint(folder: Path) -> object:
    return policies.load(folder)


def read_dataset(folder: Path) -> object:
    return ResidentDataset(folder, num_threads=1), dataset_hash(folder)


def read_results(folder: Path) -> object:
    return [read_result(path) for path in folder.rglob("*.json")]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[Callable[[Path], object], Path]:
    """A checkpoint, a dataset and a result, by the function that reads them."""
    folder = tmp_path_factory.mktemp("sound")
    make("act").save(folder / "checkpoint")
    with DatasetWriter(folder / "dataset", fps=FPS, features=FEATURES, robot_type="franka") as writer:
        for index in range(3):
            writer.add_episode(make_episode(index))
    (folder / "results").mkdir()
    shutil.copy(sorted(ROOT.glob("results/v*/*/act/*.json"))[0], folder / "results")
    return {
        read_checkpoint: folder / "checkpoint",
        read_dataset: folder / "dataset",
        read_results: folder / "results",
    }


@pytest.mark.parametrize("read", [read_checkpoint, read_dataset, read_results])
@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param(range(SHORT), id="some"),
        pytest.param(range(SHORT, WHOLE), id="rest", marks=pytest.mark.long),
    ],
)
def test_corrupt_files_are_refused(sound, tmp_path, monkeypatch, read, numbers) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = []
    for number in numbers:
        copy = tmp_path / "copy"
        shutil.copytree(sound[read], copy)
        done = corrupt(copy, number)
        try:
            read(copy)
        except RoboVerseError as error:
            if str(copy) not in str(error):
                wrong.append(f"{done}: the message names no file: {error}")
        except BaseException as error:
            wrong.append(f"{done}: {type(error).__name__}: {str(error)[:200]}")
        else:
            if "safetensors" in done and read is read_checkpoint:
                wrong.append(f"{done}: weights that were changed are read")
        shutil.rmtree(copy)
    assert not wrong, "\n".join(wrong)
    assert not (tmp_path / "ran").exists()
