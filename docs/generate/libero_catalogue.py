"""Writes ``tasks.json`` and ``pro_tasks.json`` of ``envs/tasks/libero``: names and instructions of tasks.

``python -m docs.generate.libero_catalogue`` reads the task files of the extras ``libero`` and
``libero-pro``. Tasks of a suite
are in LIBERO's own order, that of its ``libero_suite_task_map.py``: a task's place is its ``task_id``.
"""

import ast
import json
import sys

from envs.core.atomic import write_file
from envs.tasks.libero.bddl import read_problem
from envs.tasks.libero.catalogue import CATALOGUE, PRO_CATALOGUE, PRO_SUITES, SUITES, VARIANTS
from envs.tasks.libero.files import order_file, problem_files


def catalogue_text() -> str:
    """Returns the content of LIBERO's file: suite to file name to instruction."""
    return _text({suite: suite for suite in SUITES})


def pro_catalogue_text() -> str:
    """Returns the content of LIBERO-PRO's file: suite and variant to file name to instruction."""
    return _text({f"{suite}_{variant}": suite for suite in PRO_SUITES for variant in VARIANTS})


def _text(folders: dict[str, str]) -> str:
    """Returns the instructions of folders, each in the order of a suite."""
    order, found = _order(), {}
    for folder, suite in folders.items():
        words = {path.stem: _instruction(read_problem(path).language) for path in problem_files(folder)}
        found[folder] = {file: words[file] for file in order[f"libero_{suite}"]}
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


def _order() -> dict[str, list[str]]:
    """Returns suite to the names of its files, from LIBERO's source, which is read and not run."""
    (value,) = (
        node.value
        for node in ast.parse(order_file().read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "libero_task_map"
    )
    return ast.literal_eval(value)


def _instruction(language: str) -> str:
    """Returns LIBERO's words in lower case, without a full stop, as its data sets have them."""
    return language.strip().rstrip(".").lower()


if __name__ == "__main__":
    write_file(CATALOGUE, catalogue_text().encode())
    write_file(PRO_CATALOGUE, pro_catalogue_text().encode())
    sys.exit(0)
