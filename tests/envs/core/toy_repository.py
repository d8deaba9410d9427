"""A git repository of this machine with one asset folder, reached by file://."""

import subprocess
from pathlib import Path
from typing import Any

from envs.core.assets import ASSETS, AssetFolder, folder_digest
from envs.core.registry import Entry


def git(folder: Path, *arguments: str) -> str:
    """Runs git; returns what it prints."""
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    done = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def toy_repository(work: Path, files: dict[str, str], paths: tuple[str, ...], **facts: Any) -> AssetFolder:
    """Commits files to a new repository; returns the asset folder of its paths."""
    for name, text in files.items():
        path = work / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode())
    git(work, "init", "--quiet")
    git(work, "config", "uploadpack.allowFilter", "true")
    git(work, "config", "uploadpack.allowAnySHA1InWant", "true")
    git(work, "add", ".")
    git(work, "commit", "--quiet", "-m", "first")
    return AssetFolder(
        repository=work.as_uri(),
        commit=git(work, "rev-parse", "HEAD"),
        paths=paths,
        sha256=folder_digest(work, paths),
        size_mb=0.1,
        licence_file="LICENSE",
        used_by="toys/*",
        **facts,
    )


def register(monkeypatch: Any, folder: AssetFolder) -> None:
    """Registers the folder as ``toys`` for one test."""
    monkeypatch.setitem(ASSETS._entries, "toys", Entry("toys", folder))
