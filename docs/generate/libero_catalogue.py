"""Writes ``envs/tasks/libero/tasks.json``, the names and instructions of LIBERO's tasks.

``python -m docs.generate.libero_catalogue`` reads the task files of the extra ``libero``.
"""

import json
import sys

from envs.core.atomic import write_file
from envs.tasks.libero.bddl import read_problem
from envs.tasks.libero.catalogue import CATALOGUE, SUITES
from envs.tasks.libero.files import problem_files


def catalogue_text() -> str:
    """Returns the file's content: suite to file name to instruction."""
    suites = {
        suite: {path.stem: _instruction(read_problem(path).language) for path in problem_files(suite)}
        for suite in SUITES
    }
    return json.dumps(suites, indent=1) + "\n"


def _instruction(language: str) -> str:
    """Returns LIBERO's words in lower case, without a full stop, as its data sets have them."""
    return language.strip().rstrip(".").lower()


if __name__ == "__main__":
    write_file(CATALOGUE, catalogue_text().encode())
    sys.exit(0)
