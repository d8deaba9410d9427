"""``roboverse assets list`` and ``roboverse assets get <name>``: what tasks need that is not part of this.

There are two kinds: packages of an extra, which pip installs, and folders of public git repositories, which
``get`` downloads at a pinned commit. Nothing is downloaded by any other command.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from envs.core.asset_download import get_asset
from envs.core.assets import ASSETS, DATA_VARIABLE, asset_folder
from envs.core.errors import ConfigError, unknown_name
from envs.core.extras import install_command
from envs.tasks import TASKS
from roboverse_learn.config.path_keys import check_path
from roboverse_learn.extras import is_installed

ACTIONS = ("list", "get")

INSTALLED_MB = {"humanoid": 190, "libero": 662, "libero-pro": 45, "metaworld": 40}
"""Sizes of the packages of an extra on the disk, as their records of files have them."""


@dataclass(frozen=True, slots=True)
class Need:
    """Something that tasks need.

    Attributes:
        name: Its name.
        kind: ``packages`` of an extra, or a ``folder`` of a repository.
        used_by: The tasks.
        size_mb: Size on the disk; None where nobody has said it.
        licence: Its licence.
        here: Where it is, or whether it is installed; empty where it is absent.
        command: What installs or downloads it.
    """

    name: str
    kind: Literal["packages", "folder"]
    used_by: str
    size_mb: float | None
    licence: str
    here: str
    command: str


def assets(words: Sequence[str]) -> str:
    """Runs one action; returns what to print.

    Raises:
        UnknownNameError: There is no such action, setting or asset folder.
        ConfigError: A name is missing, or ``assets_dir`` does not hold the folder.
        DownloadError: The download failed, or its files are not those expected.
    """
    action, *rest = words or ["list"]
    if action not in ACTIONS:
        raise unknown_name("action on assets", action, ACTIONS, "As in: roboverse assets list")
    if action == "list":
        return table(rest)
    settings = dict(word.split("=", 1) for word in rest if "=" in word)
    names = [word for word in rest if "=" not in word]
    for key in settings:
        if key != "assets_dir":
            raise unknown_name("key of assets get", key, ("assets_dir",))
        check_path(key, key, settings[key])
    if not names:
        raise ConfigError(f"assets get needs a name. Valid: {', '.join(ASSETS.names())}.")
    return "\n".join(_get(name, settings.get("assets_dir")) for name in names)


def table(words: Sequence[str] = ()) -> str:
    """Returns what tasks need, as a table; only what has all of the words.

    Raises:
        ConfigError: Nothing has them.
    """
    found = [need for need in needs() if all(word.lower() in _text_of(need) for word in words)]
    if not found:
        raise ConfigError(f"No assets have the words {' and '.join(words)}. All: roboverse assets list.")
    lines = []
    for need in found:
        size = "size unknown" if need.size_mb is None else f"{need.size_mb:g} MB"
        lines += [
            f"{need.name} ({need.kind}, {size}): {need.here or 'not here'}",
            f"  for      {need.used_by}",
            f"  licence  {need.licence}",
            *(() if need.here else (f"  get it   {need.command}",)),
        ]
    return "\n".join([*lines, "", "All other tasks need nothing more."])


def needs() -> Iterator[Need]:
    """Yields everything that some tasks need, by name; nothing heavy is imported."""
    for extra, (used_by, licence) in sorted(_extras().items()):
        here = "installed" if is_installed(extra) else ""
        yield Need(extra, "packages", used_by, INSTALLED_MB.get(extra), licence, here, install_command(extra))
    for name in ASSETS:
        folder = ASSETS.get(name)
        try:
            here = str(asset_folder(name))
        except ConfigError:
            here = ""
        command = f"roboverse assets get {name}   (or set {DATA_VARIABLE} to the folder that holds it)"
        yield Need(name, "folder", folder.used_by, folder.size_mb, folder.licence, here, command)


def _extras() -> dict[str, tuple[str, str]]:
    """Returns each extra that tasks need, with the tasks by source, and the licences."""
    sources: dict[str, dict[str, int]] = {}
    licences: dict[str, dict[str, None]] = {}
    for entry in map(TASKS.entry, TASKS):
        if entry.extra is None:
            continue
        family = entry.info.get("source", entry.name)
        counts = sources.setdefault(entry.extra, {})
        counts[family] = counts.get(family, 0) + 1
        licences.setdefault(entry.extra, {})[entry.info.get("licence", "unknown")] = None
    return {
        extra: (
            ", ".join(f"{count} of {family}" for family, count in counts.items()),
            "; ".join(licences[extra]),
        )
        for extra, counts in sources.items()
    }


def _text_of(need: Need) -> str:
    return f"{need.name} {need.kind} {need.used_by} {need.licence}".lower()


def _get(name: str, assets_dir: str | None) -> str:
    if name not in ASSETS and name in _extras():
        raise ConfigError(f"'{name}' are packages: {install_command(name)}")
    place = get_asset(name, assets_dir)
    folder = ASSETS.get(name)
    return f"{place}\n{folder.size_mb:g} MB, licence {folder.licence}: {place / folder.licence_file}"
