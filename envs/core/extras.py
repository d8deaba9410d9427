"""The command that installs an extra of the package."""

import shlex
from pathlib import Path

DISTRIBUTION = "roboverse-learn"

PINNED = ("libero", "libero-pro")
"""Extras whose packages require old versions of others, which ``overrides.txt`` sets aside."""

_CHECKOUT = Path(__file__).resolve().parents[2]
"""The folder of a checkout; where the package is a wheel, that of the installed packages."""

_PINS, _OVERRIDES = "constraints.txt", "overrides.txt"


def install_command(extra: str) -> str:
    """Returns the command that installs an extra, for the folder in which this process is.

    In a checkout it keeps the versions that the README installs; of a wheel nothing is pinned.
    """
    if not all((_CHECKOUT / name).is_file() for name in ("pyproject.toml", _PINS, _OVERRIDES)):
        requirement = f"'{DISTRIBUTION}[{extra}]'"
        return f"{_with_pins()} {requirement}" if extra in PINNED else f"pip install {requirement}"
    return checkout_command(extra, "" if Path.cwd() == _CHECKOUT else f"{_CHECKOUT}/")


def checkout_command(extra: str, checkout: str = "") -> str:
    """Returns the command that installs an extra of a checkout.

    Args:
        extra: The extra.
        checkout: The checkout's folder with a slash at its end; empty where the command runs in it.
    """
    return f"{_with_pins(checkout)} -e {shlex.quote(f'{checkout.rstrip("/") or "."}[{extra}]')}"


def _with_pins(folder: str = "") -> str:
    pins, overrides = shlex.quote(f"{folder}{_PINS}"), shlex.quote(f"{folder}{_OVERRIDES}")
    return f"uv pip install -c {pins} --override {overrides}"
