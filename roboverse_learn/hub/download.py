"""A dataset of the Hugging Face hub, as a folder here."""

from pathlib import Path

from envs.core.atomic import write_file
from envs.core.errors import ConfigError
from roboverse_learn.data.dataset.schema import CODEBASE_VERSION, INFO_PATH
from roboverse_learn.hub.names import check_name, hub_errors

_NO_CODE = ["*.py", "*.pkl", "*.pickle", "*.pt", "*.bin"]

_CACHE = ".cache/huggingface"
"""Folder in which the hub's library notes what it has fetched."""

_ORIGIN = f"{_CACHE}/roboverse_origin.txt"
"""Name on the hub of the dataset that a folder is of."""


def get_dataset(name: str, folder: Path, revision: str = "") -> Path:
    """Downloads a LeRobotDataset; files that are there already are not fetched again.

    Args:
        name: Name on the hub, ``owner/name``.
        folder: Where it goes. A download that was interrupted continues.
        revision: Branch, tag or commit; empty for the tag of LeRobot's version of the format, or else the
            newest commit, as LeRobot does.

    Returns:
        The folder.

    Raises:
        ConfigError: The name is none, the hub does not give it, it is no LeRobotDataset, or the folder holds
            other files.
    """
    check_name("from", name)
    _check_folder(name, folder)
    from huggingface_hub import HfApi, snapshot_download

    api = HfApi()
    with hub_errors(f"get the dataset '{name}'"):
        if not revision:
            tags = [each.name for each in api.list_repo_refs(name, repo_type="dataset").tags]
            revision = CODEBASE_VERSION if CODEBASE_VERSION in tags else "main"
        # Where the hub is out of reach, snapshot_download returns a folder of half a dataset as it is.
        files = api.list_repo_files(name, repo_type="dataset", revision=revision)
        if INFO_PATH not in files:
            raise ConfigError(
                f"'{name}' is no LeRobotDataset: it has no {INFO_PATH}. Nothing was downloaded."
            )
        write_file(folder / _ORIGIN, name.encode())
        snapshot_download(
            name, repo_type="dataset", revision=revision, local_dir=folder, ignore_patterns=_NO_CODE
        )
    return folder


def _check_folder(name: str, folder: Path) -> None:
    """Checks that a folder is new or empty, or holds what an earlier download of this dataset left."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not (folder / _CACHE).is_dir():
        raise ConfigError(f"out={folder} holds files of another origin. Name a new folder.")
    origin = folder / _ORIGIN
    before = origin.read_text() if origin.is_file() else name
    if before != name:
        raise ConfigError(f"out={folder} holds the dataset '{before}', not '{name}'. Name a new folder.")
