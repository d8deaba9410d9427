"""Downloads an asset folder from its public git repository, at one commit, with its licence beside it."""

import logging
import os
import shutil
import subprocess
from pathlib import Path

from envs.core.assets import (
    ASSETS,
    AssetFolder,
    asset_folder,
    downloaded_folder,
    folder_digest,
    is_asset_folder,
)
from envs.core.atomic import fsync, write_errors, write_json
from envs.core.errors import ConfigError, RoboVerseError

logger = logging.getLogger(__name__)

RECORD = "roboverse_asset.json"
"""File in a downloaded folder: where it comes from."""


class DownloadError(RoboVerseError, OSError):
    """Assets that could not be downloaded, or are not what was expected."""


def get_asset(name: str, assets_dir: str | None = None) -> Path:
    """Downloads a registered folder where it is absent and returns it.

    The paths are fetched one after another, so that a call after an interrupted one fetches what is missing.
    Nothing is visible under the final name before every file has the expected hash.

    Args:
        name: A name of :data:`envs.core.assets.ASSETS`.
        assets_dir: A copy of the folder on this machine, or what holds it; the copy is checked and used
            where it is, and nothing is downloaded.

    Raises:
        UnknownNameError: There is no such asset folder.
        ConfigError: It is not in ``assets_dir``.
        DownloadError: Git is absent or fails, or a hash differs.
        WriteError: The disk is full or the folder cannot be written.
    """
    folder, final = ASSETS.get(name), downloaded_folder(name)
    if assets_dir is not None:
        return _checked_copy(name, folder, assets_dir)
    if is_asset_folder(final, folder):
        return final
    work = final.with_name(f"{name}.download")
    with write_errors(final):
        work.mkdir(parents=True, exist_ok=True)
        _fetch(name, folder, work)
        _check(name, folder, work)
        shutil.rmtree(work / ".git")
        write_json(work / RECORD, _record(name, folder))
        fsync(work)
        if final.exists():  # of an older version, or cut in half by hand
            shutil.rmtree(final)
        os.rename(work, final)
    return final


def _checked_copy(name: str, folder: AssetFolder, assets_dir: str) -> Path:
    place = asset_folder(name, assets_dir)
    digest = folder_digest(place, folder.paths)
    if digest != folder.sha256:
        raise DownloadError(
            f"The files of '{name}' in {place} have the hash {digest[:12]}, expected {folder.sha256[:12]}: "
            f"they are not those of {folder.repository} at {folder.commit[:12]}."
        )
    return place


def _record(name: str, folder: AssetFolder) -> dict[str, str]:
    return {
        "name": name,
        "repository": folder.repository,
        "commit": folder.commit,
        "licence": folder.licence,
        "licence_file": folder.licence_file,
        "sha256": folder.sha256,
    }


def _fetch(name: str, folder: AssetFolder, work: Path) -> None:
    """Fetches the commit without its files, then each path's files; done paths are skipped."""
    _git(name, work, "init", "--quiet")  # also where a kill left half of .git, which is mended so
    _git(name, work, "config", "core.autocrlf", "false")
    _git(name, work, "config", "remote.origin.url", folder.repository)
    _git(name, work, "config", "remote.origin.promisor", "true")
    _git(name, work, "config", "remote.origin.partialclonefilter", "blob:none")
    if not _has_commit(work, folder.commit):
        _git(name, work, "fetch", "--quiet", "--depth=1", "--filter=blob:none", "origin", folder.commit)
    for path in (folder.licence_file, *folder.paths):
        logger.info("%s: %s", name, path)
        _git(name, work, "checkout", "--quiet", folder.commit, "--", path)


def _check(name: str, folder: AssetFolder, work: Path) -> None:
    digest = folder_digest(work, folder.paths)
    if digest != folder.sha256:
        shutil.rmtree(work)
        raise DownloadError(
            f"The files of '{name}' from {folder.repository} at {folder.commit[:12]} have the hash "
            f"{digest[:12]}, expected {folder.sha256[:12]}. They were deleted; download them again with: "
            f"roboverse assets get {name}"
        )
    if not (work / folder.licence_file).is_file():
        raise ConfigError(f"The repository of '{name}' has no licence file '{folder.licence_file}'.")


def _has_commit(work: Path, commit: str) -> bool:
    command = ["git", "-C", str(work), "cat-file", "-e", f"{commit}^{{tree}}"]
    without_network = {**os.environ, "GIT_NO_LAZY_FETCH": "1"}
    return subprocess.run(command, capture_output=True, env=without_network, check=False).returncode == 0


def _git(name: str, work: Path, *arguments: str) -> None:
    """Runs git in ``work``; it asks for no password, and its last line is in the error."""
    command = ["git", "-C", str(work), *arguments]
    environment = {**os.environ, "GIT_TERMINAL_PROMPT": "0", "LC_ALL": "C"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    except FileNotFoundError:
        raise DownloadError(
            f"The assets '{name}' are downloaded with git, which is not installed. Install git, or put the "
            f"files into a folder '{name}' and set ROBOVERSE_DATA to the folder above it."
        ) from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise DownloadError(
            f"The assets '{name}' could not be downloaded: git {arguments[0]} says: {lines[-1]} "
            f"Check the network and run it again; what has arrived is kept: roboverse assets get {name}"
        )
