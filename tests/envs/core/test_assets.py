"""Where asset folders are looked for, and their download from a git repository of this machine."""

import json
import shutil
from dataclasses import replace

import pytest

from envs.core import asset_download
from envs.core.asset_download import RECORD, DownloadError, get_asset
from envs.core.assets import ASSETS, asset_folder, downloaded_folder, folder_digest, resolve
from envs.core.errors import ConfigError, MissingAssetError, UnknownNameError
from tests.envs.core.toy_repository import git, register, toy_repository


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOVERSE_DATA", raising=False)


@pytest.fixture
def toys(tmp_path, monkeypatch, cache):
    """Registers a folder of a repository that is served by file://."""
    work = tmp_path / "repository"
    files = {
        "LICENSE": "Do as you like",
        "data/a/one.obj": "v 0 0 0\n",
        "data/b/two.obj": "v 1 1 1\r\n",
        "videos/big.mp4": "frames",
    }
    folder = toy_repository(
        work,
        files,
        ("data/a", "data/b"),
        needs=("data/a/one.obj",),
        licence="MIT",
        other_names=("toy_box",),
    )
    register(monkeypatch, folder)
    (work / "data/a/one.obj").write_text("v 9 9 9\n")  # a later commit, which is not the pinned one
    git(work, "commit", "--quiet", "-am", "second")
    return folder


def test_a_download_has_the_pinned_files_the_licence_and_its_origin_and_nothing_else(toys):
    place = get_asset("toys")
    names = sorted(file.relative_to(place).as_posix() for file in place.rglob("*") if file.is_file())
    assert names == ["LICENSE", "data/a/one.obj", "data/b/two.obj", RECORD]
    assert (place / "data/a/one.obj").read_text() == "v 0 0 0\n"
    assert (place / "data/b/two.obj").read_bytes() == b"v 1 1 1\r\n"
    assert json.loads((place / RECORD).read_text())["commit"] == toys.commit
    assert asset_folder("toys") == place.resolve()


def test_a_second_download_of_a_complete_folder_runs_nothing(toys, monkeypatch):
    get_asset("toys")
    monkeypatch.setattr(asset_download, "_git", None)
    assert get_asset("toys") == downloaded_folder("toys")


def test_an_interrupted_download_keeps_what_arrived_and_fetches_the_rest(toys, monkeypatch):
    git_as_it_is, calls = asset_download._git, []

    def recorded(name, work, *arguments):
        calls.append(arguments)
        if arguments[-1] == "data/b" and len(calls) < 10:
            raise KeyboardInterrupt
        git_as_it_is(name, work, *arguments)

    monkeypatch.setattr(asset_download, "_git", recorded)
    with pytest.raises(KeyboardInterrupt):
        get_asset("toys")
    with pytest.raises(ConfigError, match="not on this machine"):
        asset_folder("toys")
    assert sum(call[0] == "fetch" for call in calls) == 1
    calls += [("",)] * 10
    place = get_asset("toys")
    assert sum(call[0] == "fetch" for call in calls) == 1
    assert folder_digest(place, toys.paths) == toys.sha256


@pytest.mark.parametrize("removed", ["objects", "refs", "HEAD"])
def test_a_download_that_was_killed_while_it_removed_git_is_finished(toys, monkeypatch, removed):
    def killed(folder):
        part = folder / removed
        remove(part) if part.is_dir() else part.unlink()
        raise KeyboardInterrupt

    remove = shutil.rmtree
    with monkeypatch.context() as kill:
        kill.setattr(asset_download.shutil, "rmtree", killed)
        with pytest.raises(KeyboardInterrupt):
            get_asset("toys")
    assert folder_digest(get_asset("toys"), toys.paths) == toys.sha256


def test_files_of_another_hash_are_refused_and_deleted(toys, monkeypatch):
    register(monkeypatch, replace(toys, sha256="0" * 64))
    with pytest.raises(DownloadError, match=r"have the hash .* expected 000000000000"):
        get_asset("toys")
    assert not downloaded_folder("toys").exists()
    assert not list(downloaded_folder("toys").parent.iterdir())


def test_a_repository_that_cannot_be_reached_is_reported_with_what_git_says(toys, monkeypatch, tmp_path):
    register(monkeypatch, replace(toys, repository=(tmp_path / "nowhere").as_uri()))
    with pytest.raises(DownloadError, match=r"could not be downloaded: git fetch says: .*assets get toys"):
        get_asset("toys")


def test_without_git_the_error_says_what_to_do(toys, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DownloadError, match=r"Install git, or put the files into a folder 'toys'"):
        get_asset("toys")


@pytest.mark.parametrize("name", ["toys", "toy_box", "."])
def test_a_folder_is_found_below_the_data_variable_and_below_assets_dir(toys, monkeypatch, tmp_path, name):
    place = tmp_path / "mine" / name
    (place / "data/a").mkdir(parents=True)
    (place / "data/a/one.obj").touch()
    assert asset_folder("toys", str(tmp_path / "mine")) == place.resolve()
    monkeypatch.setenv("ROBOVERSE_DATA", str(tmp_path / "mine"))
    assert asset_folder("toys") == place.resolve()


def test_an_absent_folder_names_licence_size_and_the_command_that_downloads_it(cache, tmp_path):
    with pytest.raises(
        ConfigError, match=r"'calvin' \(MIT, 17 MB\).*Download it with: roboverse assets get calvin"
    ):
        asset_folder("calvin")
    with pytest.raises(ConfigError, match="assets_dir="):
        asset_folder("calvin", str(tmp_path))


def test_a_reference_names_a_file_of_a_folder(toys):
    with pytest.raises(MissingAssetError, match="Download it with: roboverse assets get toys"):
        resolve("assets.toys:data/a/one.obj")
    place = get_asset("toys")
    assert resolve("assets.toys:data/a/one.obj") == place.resolve() / "data/a/one.obj"
    with pytest.raises(ConfigError, match=r"'assets\.toys:data/a/three\.obj' does not exist"):
        resolve("assets.toys:data/a/three.obj")
    with pytest.raises(UnknownNameError, match=r"Unknown asset folder 'toyz'\. Did you mean 'toys'"):
        resolve("assets.toyz:data/a/one.obj")


def test_an_unknown_folder_is_reported_with_the_nearest():
    with pytest.raises(UnknownNameError, match="Did you mean 'calvin'"):
        asset_folder("calvn")


def test_the_digest_changes_with_a_name_and_with_a_byte(tmp_path):
    (tmp_path / "a").write_text("1")
    first = folder_digest(tmp_path, ("a",))
    (tmp_path / "b").write_text("1")
    (tmp_path / "a").write_text("2")
    assert len({first, folder_digest(tmp_path, ("a",)), folder_digest(tmp_path, ("b",))}) == 3
    with pytest.raises(ConfigError, match="has no 'c'"):
        folder_digest(tmp_path, ("c",))


def test_calvins_registered_hash_is_that_of_its_files():
    try:
        place = asset_folder("calvin")
    except ConfigError:
        pytest.skip(
            "CALVIN's files are not on this machine; ROBOVERSE_DATA may name the folder that has them"
        )
    folder = ASSETS.get("calvin")
    assert folder_digest(place, folder.paths) == folder.sha256
    size = sum(
        file.stat().st_size for each in folder.paths for file in (place / each).rglob("*") if file.is_file()
    )
    assert size / 1e6 == pytest.approx(folder.size_mb, abs=0.5)
