"""Folders of caches: whole or absent, whichever process makes them first."""

import pytest

from envs.core.atomic import cached_directory


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
