"""CONTRIBUTING names files and folders that are there, and every contract."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def rows(header: str) -> list[list[str]]:
    """Returns the cells of the table with a header, without that."""
    table = TEXT[TEXT.index(header) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table]


def paths(cell: str) -> list[str]:
    """Returns the files and folders of a cell: a file without a folder lies beside what is before it."""
    found: list[str] = []
    for name in re.findall(r"`([\w<>]+[./][\w./<>]*)`", cell):
        beside = f"{found[-1].rpartition('/')[0]}/{name}" if found and "/" not in name else name
        found.append(beside.partition("<")[0])
    return found


def missing(cell: str) -> list[str]:
    return [path for path in paths(cell) if "/" in path and not (ROOT / path).exists()]


def test_what_a_reader_looks_for_is_where_the_tables_say() -> None:
    layout, questions = rows("| looking for | look in |"), rows("| question | answer |")
    assert len(layout) > 20 and len(questions) == 10
    assert all(paths(row[-1]) for row in (*layout, *questions))
    assert [name for row in (*layout, *questions) for name in missing(row[-1])] == []


def test_every_contract_is_in_the_table() -> None:
    named = {path for row in rows("| of | promises | in |") for path in paths(row[-1])}
    files = {str(path.relative_to(ROOT)) for path in (ROOT / "tests/contracts").glob("test_*.py")}
    assert files <= named and all((ROOT / path).is_file() for path in named)


def test_a_missing_folder_is_found() -> None:
    assert missing("`envs/nowhere/`, then `envs/core/`, `atomic.py` and `gone.py`") == [
        "envs/nowhere/",
        "envs/core/gone.py",
    ]
