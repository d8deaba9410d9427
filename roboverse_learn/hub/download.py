"""A dataset of the Hugging Face hub, as a folder here."""

from pathlib import Path

from envs.core.errors import ConfigError
from roboverse_learn.data.dataset.schema import CODEBASE_VERSION, INFO_PATH
from roboverse_learn.hub.names import check_name, hub_errors

_NO_CODE = ["*.py", "*.pkl", "*.pickle", "*.pt", "*.bin"]


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
    if folder.exists() and any(folder.iterdir()) and not (folder / ".cache/huggingface").is_dir():
        raise ConfigError(f"out={folder} holds files of another origin. Name a new folder.")
    from huggingface_hub import HfApi, snapshot_download

    with hub_errors(f"get the dataset '{name}'"):
        if not revision:
            tags = [each.name for each in HfApi().list_repo_refs(name, repo_type="dataset").tags]
            revision = CODEBASE_VERSION if CODEBASE_VERSION in tags else "main"
        snapshot_download(
            name, repo_type="dataset", revision=revision, local_dir=folder, ignore_patterns=_NO_CODE
        )
    if not (folder / INFO_PATH).is_file():
        raise ConfigError(f"'{name}' is no LeRobotDataset: it has no {INFO_PATH}. It is in '{folder}'.")
    return folder
