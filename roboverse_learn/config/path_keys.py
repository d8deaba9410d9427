"""Keys whose value is a file or a folder."""

from envs.core.errors import empty_path

PATH_KEYS = frozenset(
    (
        *("dataset", "datasets_dir", "from_dataset", "recordings", "path", "run", "runs_dir", "results_dir"),
        *("checkpoint", "result", "file", "out", "packages", "cert", "key", "materials"),
        *("evaluate.materials", "policy.path", "assets_dir"),
    )
)
"""Full names of these keys, of every command."""


def check_path(key: str, typed: str, value: object) -> None:
    """Checks that a key of a file or folder has a value.

    Args:
        key: Full name of the key.
        typed: The key as it was typed.
        value: What it was given.

    Raises:
        ConfigError: It is of a file or folder, and was given none.
    """
    if key in PATH_KEYS and isinstance(value, str) and not value.strip():
        raise empty_path(typed)
