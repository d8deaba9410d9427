"""Where a checkpoint comes from: a folder, or a name on the Hugging Face hub, checked before a download."""

import re
import shutil
from pathlib import Path

from envs.core.errors import PolicyError

_HUB_NAME = re.compile(r"[\w.-]+/[\w.-]+(@[\w.-]+)?")
CHECKPOINT_FILES = ("*.json", "*.safetensors", "*.txt", "*.model", "*.jinja")
"""Files of a checkpoint that are read: no code, and no pickle."""

_DISK, _MEMORY = 1.1, 2.1
"""Free disk and memory per size of the files; what is read and the network are in memory at once."""


def is_hub_name(path: str) -> bool:
    """Whether a path has the form of a hub name, ``owner/name[@revision]``, and is no folder here."""
    if Path(path).exists() or not _HUB_NAME.fullmatch(path):
        return False
    return not Path(path.split("/")[0]).exists()


def local_folder(path: str) -> Path:
    """Returns the folder of a checkpoint; one on the hub is downloaded once, into the hub's own cache.

    Args:
        path: A folder, or a hub name such as ``lerobot/smolvla_base``, with ``@<revision>`` for a commit or
            a tag.

    Raises:
        PolicyError: if there is neither, the hub cannot be asked, or disk or memory do not suffice.
    """
    from policies.checkpoint import resolve, weights_path

    if not is_hub_name(path):
        return resolve(path)
    from httpx import HTTPError
    from huggingface_hub import constants, snapshot_download
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError

    name, _, revision = path.partition("@")
    try:
        cached = Path(
            snapshot_download(
                name, revision=revision or None, allow_patterns=list(CHECKPOINT_FILES), local_files_only=True
            )
        )
        if weights_path(cached).is_file():  # another program may have fetched the configuration alone
            return cached
    except (LocalEntryNotFoundError, FileNotFoundError):
        pass
    try:
        check_room(_hub_bytes(name, revision or None), Path(constants.HF_HUB_CACHE), path)
        return Path(snapshot_download(name, revision=revision or None, allow_patterns=list(CHECKPOINT_FILES)))
    except (HfHubHTTPError, HTTPError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise PolicyError(
            f"'{path}' is no folder here, and the Hugging Face hub did not give it: {reason}. Name a folder "
            "with config.json and weights, or a public hub name, on a machine with a network; HF_HUB_OFFLINE "
            "must not be set."
        ) from error


def check_room(size: int, cache: Path, name: str) -> None:
    """Checks, before a download, that the disk can hold the files and the memory the weights.

    Args:
        size: Bytes of the files.
        cache: Folder that they go to.
        name: What is downloaded, for the message.

    Raises:
        PolicyError: if either does not suffice.
    """
    import psutil

    existing = next(folder for folder in (cache, *cache.absolute().parents) if folder.exists())
    free_disk, free_memory = shutil.disk_usage(existing).free, psutil.virtual_memory().available
    for what, factor, free, advice in (
        ("disk", _DISK, free_disk, f"Free some, or set HF_HOME to another disk than that of {existing}."),
        ("memory", _MEMORY, free_memory, "Take a machine with more."),
    ):
        if free < factor * size:
            raise PolicyError(
                f"'{name}' has {size / 1e9:.1f} GB, which needs {factor * size / 1e9:.1f} GB of free {what}, "
                f"and this machine has {free / 1e9:.1f} GB. Nothing was downloaded. {advice}"
            )


def _hub_bytes(name: str, revision: str | None) -> int:
    from fnmatch import fnmatch

    from huggingface_hub import HfApi

    files = HfApi().model_info(name, revision=revision, files_metadata=True).siblings or []
    return sum(each.size or 0 for each in files if any(fnmatch(each.rfilename, p) for p in CHECKPOINT_FILES))


def base_name(path: str) -> str:
    """Returns what adapters remember of their model: its hub name, or its absolute folder."""
    return path if is_hub_name(path) else str(local_folder(path).resolve())
