"""The command that installs an extra of the package."""

DISTRIBUTION = "roboverse-learn"

PINNED = ("libero", "libero-pro")
"""Extras whose packages require old versions of others, which ``overrides.txt`` sets aside."""


def install_command(extra: str) -> str:
    """Returns the command that installs an extra."""
    if extra in PINNED:
        return f"uv pip install -c constraints.txt --override overrides.txt '{DISTRIBUTION}[{extra}]'"
    return f"pip install '{DISTRIBUTION}[{extra}]'"
