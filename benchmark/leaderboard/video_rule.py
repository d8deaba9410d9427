"""Which videos a folder of results keeps: one success and one failure per entry and level."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmark.leaderboard.standings import standings
from benchmark.results import ResultError

KEEP_FILE = "keep_videos.txt"
"""Videos of a folder of results that stay besides those of the rule: a path relative to the folder a line."""


def kept_videos(board: Mapping[str, Any]) -> set[str]:
    """Returns the videos that stay, as paths relative to the folder of results.

    They are of the test split of the cells that the board shows of an entry where it was trained: by
    protocol A or B. Of several seeds, the first that has one. Where a recipe of a policy has videos of a
    task, those of the policy's presets go.
    """
    kept: set[str] = set()
    for section in board["sections"]:
        shown = [
            series
            for of in standings(section).values()
            for series in of
            if series["entry"] is not None and series["transferred_from"] is None
        ]
        kinds = {series["entry"]: board["entries"][series["entry"]]["kind"] for series in shown}
        of_recipes, of_presets = dict[str, set[str]](), dict[str, set[str]]()
        for series in shown:
            of_kind = of_recipes if kinds[series["entry"]] == "recipe" else of_presets
            of_kind.setdefault(series["policy"], set()).update(_of_series(section, series))
        for policy in {*of_recipes, *of_presets}:
            kept |= of_recipes.get(policy) or of_presets.get(policy, set())
    return kept


def _of_series(section: Mapping[str, Any], series: Mapping[str, Any]) -> set[str]:
    first: dict[tuple[str, str], str] = {}
    for index in series["rows"]:
        for video in section["rows"][index]["videos"]:
            level = video["condition"].removeprefix("level")
            if video["split"] == "test" and level in series["cells"]:
                first.setdefault((f"{index} {level}", video["outcome"]), video["path"])
    wanted = {f"{index} {level}" for index in series["rows"] for level in _levels(section, series, index)}
    return {path for (cell, _), path in first.items() if cell in wanted}


def _levels(section: Mapping[str, Any], series: Mapping[str, Any], index: int) -> set[str]:
    """Returns the levels whose shown cell is of this row."""
    own = [cell for cell in section["rows"][index]["cells"] if cell["split"] == "test"]
    return {level for level, cell in series["cells"].items() if cell["test"] in own}


def named_videos(results_dir: Path) -> set[str]:
    """Returns the paths in :data:`KEEP_FILE`, without empty lines and comments (``#``); none without a file.

    Raises:
        ResultError: A path has no video.
    """
    file = results_dir / KEEP_FILE
    if not file.is_file():
        return set()
    lines = (line.partition("#")[0].strip() for line in file.read_text(encoding="utf-8").splitlines())
    named = {line for line in lines if line}
    absent = sorted(path for path in named if not (results_dir / path).is_file())
    if absent:
        raise ResultError(
            f"{file} names videos that are not there: {', '.join(absent)}. Mend or remove the lines."
        )
    return named


def remove_other_videos(results_dir: Path, board: Mapping[str, Any]) -> list[Path]:
    """Removes every video of a results file that neither the rule nor the keep file keeps, with its poster.

    Videos beside no results file are left alone.

    Returns:
        The removed videos, sorted.

    Raises:
        ResultError: The keep file names a video that is not there; nothing is removed then.
    """
    kept = kept_videos(board) | named_videos(results_dir)
    removed = sorted(results_dir / path for path in set(_videos(board)) - kept)
    for path in removed:
        path.unlink(missing_ok=True)
        path.with_suffix(".png").unlink(missing_ok=True)
        if not any(path.parent.iterdir()):
            path.parent.rmdir()
    return removed


def _videos(board: Mapping[str, Any]) -> Iterator[str]:
    for section in board["sections"]:
        for row in section["rows"]:
            yield from (video["path"] for video in row["videos"])
