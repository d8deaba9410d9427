"""Which packages of an extra are installed, by the metadata of distributions; none is imported."""

from importlib import metadata

from packaging.requirements import Requirement

from envs.core.extras import DISTRIBUTION


def packages_of(extra: str) -> list[str]:
    """Returns the names of an extra's packages, from the metadata of the installed distribution."""
    needs = [Requirement(text) for text in metadata.requires(DISTRIBUTION) or ()]
    return [each.name for each in needs if each.marker and each.marker.evaluate({"extra": extra})]


def missing_packages(extra: str) -> list[str]:
    """Returns the packages of an extra that are not installed, in any version."""
    return [name for name in packages_of(extra) if not _is_there(name)]


def is_installed(extra: str) -> bool:
    """Returns whether an extra has packages and all are installed, in any version."""
    return bool(packages_of(extra)) and not missing_packages(extra)


def _is_there(name: str) -> bool:
    try:
        metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return False
    return True
