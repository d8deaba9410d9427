"""Disks that fill up in each stage: one message, exit code 2, nothing half-written, and it resumes."""

import json
import os
import resource
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from roboverse_learn import cli
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.data.dataset.raw import dataset_hash
from tests.integration.main_run import TINY, MainRun

pytestmark = pytest.mark.slow

COLLECT = [word for word in TINY if word.split("=")[0] in ("task", "image_size", "cameras", "num_demos")] + [
    "collect.num_workers=1",
    "collect.num_envs=2",
]


class SmallDisk:
    """A file system in memory, of a size that can be changed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def resize(self, size: str) -> None:
        """Makes it as large as ``size``, such as ``64k``."""
        self._mount("-o", f"remount,size={size}", str(self.folder))

    @staticmethod
    def _mount(*words: str) -> None:
        subprocess.run(["mount", *words], check=True, capture_output=True)

    @classmethod
    @contextmanager
    def at(cls, folder: Path, size: str) -> Iterator["SmallDisk"]:
        """Mounts it; skips the test where this is forbidden."""
        folder.mkdir()
        if os.geteuid() != 0 or shutil.which("mount") is None:
            pytest.skip("only root can mount a small disk")
        try:
            cls._mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder))
        except subprocess.CalledProcessError:
            pytest.skip("this machine forbids to mount a small disk")
        try:
            yield cls(folder)
        finally:
            subprocess.run(["umount", str(folder)], check=True)


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Lets this process write no file beyond ``size`` bytes, which needs no right to mount."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def files(folder: Path) -> set[str]:
    """Names of the files that a reader of the folder would take for real."""
    return {path.name for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".lock")}


def one_message(capsys: pytest.CaptureFixture[str]) -> str:
    """Returns the one error that was printed."""
    said = capsys.readouterr().err
    errors = [line for line in said.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1 and "Traceback" not in said, said
    return errors[0]


def test_collection_resumes_when_the_disk_has_room(
    main_run: MainRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SmallDisk.at(tmp_path / "disk", "64k") as disk:
        words = ["collect", *COLLECT, f"dataset={disk.folder / 'demos'}"]
        assert cli.main(words) == 2
        assert "the disk is full" in one_message(capsys)
        assert not [name for name in files(disk.folder) if name.endswith(".partial")]
        disk.resize("32m")
        assert cli.main(words) == 0
        assert dataset_hash(disk.folder / "demos") == dataset_hash(main_run.dataset)


def test_training_keeps_its_state_on_a_full_disk(
    main_run: MainRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(main_run.folder)
    with SmallDisk.at(tmp_path / "disk", "700k") as disk:
        words = ["train", *TINY, f"runs_dir={disk.folder}", f"results_dir={tmp_path / 'results'}"]
        assert cli.main(words) == 2
        said = one_message(capsys)
        assert "the disk is full" in said and "checkpoints/000004" in said
        (run,) = (disk.folder / "PickCube/act").iterdir()
        assert not files(run / "checkpoints")
        manifest = json.loads((run / "manifest.json").read_text())
        assert manifest["status"] == "stopped" and manifest["stages"]["train"]["status"] == "stopped"
        assert not (tmp_path / "results").exists()


def test_an_evaluation_that_cannot_be_written_leaves_no_result(
    main_run: MainRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["levels=[0]", "splits=[test]", "episodes=1", "device=cpu"]
    with SmallDisk.at(tmp_path / "disk", "4k") as disk:
        command = ["evaluate", f"checkpoint={main_run.run}", f"results_dir={disk.folder}", *words]
        assert cli.main(command) == 2
        assert "the disk is full" in one_message(capsys)
        assert files(disk.folder) == set()
        disk.resize("16m")
        assert cli.main(command) == 0
        assert {"leaderboard.json", "leaderboard.html"} <= files(disk.folder)


def test_a_limit_on_the_size_of_files_stops_a_collection(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["collect", *COLLECT, f"dataset={tmp_path / 'demos'}"]
    with file_size_limit(3000):
        assert cli.main(words) == 2
    assert "File too large" in one_message(capsys)
    assert not list((tmp_path / "demos/raw").glob("*.safetensors"))
    assert not [name for name in files(tmp_path) if name.endswith((".partial", ".mp4"))]


def test_a_limit_on_the_size_of_files_stops_training(
    main_run: MainRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(main_run.folder)
    words = ["train", *TINY, f"runs_dir={tmp_path / 'runs'}", f"results_dir={tmp_path / 'results'}"]
    with file_size_limit(100_000):
        assert cli.main(words) == 2
    assert "could not be written" in one_message(capsys)
    (run,) = (tmp_path / "runs/PickCube/act").iterdir()
    assert not files(run / "checkpoints")
    assert read_facts(run, "train")["status"] == "stopped"


def test_results_dir_that_is_a_file_is_refused_before_evaluation(
    main_run: MainRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "results").write_text("not a folder")
    words = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    command = ["evaluate", f"checkpoint={main_run.run}", f"results_dir={tmp_path / 'results'}", *words]
    assert cli.main(command) == 2
    assert "is a file, not a folder" in one_message(capsys)
    assert (tmp_path / "results").read_text() == "not a folder"
