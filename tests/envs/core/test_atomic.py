"""Folders are whole or absent, whichever process makes them first and wherever a kill comes."""

import subprocess
import sys

import pytest

from envs.core.atomic import atomic_directory, cached_directory, remove_partial_files, write_file
from envs.core.errors import WriteError


def test_a_cached_folder_appears_when_it_is_whole(tmp_path):
    folder = tmp_path / "cache" / "meshes"
    with cached_directory(folder) as working:
        (working / "0.stl").write_text("mesh")
        assert not folder.exists()
    assert (folder / "0.stl").read_text() == "mesh"
    assert [path.name for path in folder.parent.iterdir()] == ["meshes"], "no temporary folder is left"


def test_a_cached_folder_that_another_process_made_first_stays(tmp_path):
    folder = tmp_path / "meshes"
    with cached_directory(folder) as working:
        (working / "0.stl").write_text("second")
        folder.mkdir()
        (folder / "0.stl").write_text("first")
    assert (folder / "0.stl").read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["meshes"]


def test_an_error_leaves_no_cached_folder(tmp_path):
    with pytest.raises(ValueError, match="broken"), cached_directory(tmp_path / "meshes"):
        raise ValueError("broken")
    assert not list(tmp_path.iterdir())


def test_a_file_in_place_of_a_cached_folder_is_an_error(tmp_path):
    (tmp_path / "meshes").write_text("a file")
    with pytest.raises(OSError, match="meshes"), cached_directory(tmp_path / "meshes"):
        pass
    assert (tmp_path / "meshes").read_text() == "a file"


@pytest.mark.parametrize("below", ["a.json", "folder/a.json"])
def test_a_file_in_place_of_the_folder_of_a_file_is_named_and_stays(tmp_path, below):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(WriteError) as refused:
        write_file(tmp_path / "file" / below, b"")
    said = f"'{tmp_path / 'file'}' is a file, not a folder. Name another folder, or move the file away."
    assert str(refused.value) == said
    assert (tmp_path / "file").read_text() == "kept"


def test_a_folder_in_place_of_a_file_is_named_and_stays(tmp_path):
    (tmp_path / "info.json").mkdir()
    with pytest.raises(WriteError, match=r"info\.json' is a folder, where a file belongs\. .* move it away"):
        write_file(tmp_path / "info.json", b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["info.json"], "no temporary file is left"


KILLED = """
import os, sys
from pathlib import Path
from envs.core.atomic import atomic_directory

rename, left = os.rename, [int(sys.argv[2])]

def counted(source, target):
    left[0] -= 1
    if left[0] < 0:
        os._exit(9)
    rename(source, target)

os.rename = counted
with atomic_directory(Path(sys.argv[1])) as staging:
    (staging / "content").write_text("new")
"""


@pytest.mark.parametrize(("num_renames", "expected"), [(0, "old"), (1, "old"), (2, "new")])
def test_a_replaced_folder_is_the_old_or_the_new_one_wherever_a_kill_comes(tmp_path, num_renames, expected):
    folder = tmp_path / "model.v1"
    with atomic_directory(folder) as staging:
        (staging / "content").write_text("old")
    words = [sys.executable, "-c", KILLED, str(folder), str(num_renames)]
    done = subprocess.run(words, check=False, timeout=120)
    assert done.returncode == (9 if expected == "old" else 0)
    remove_partial_files(tmp_path)
    assert (folder / "content").read_text() == expected
    assert list(tmp_path.iterdir()) == [folder]
