"""The tasks as ``roboverse list`` shows them: from registry lines and JSON files, nothing is imported."""

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path

from envs.core.errors import ConfigError
from envs.core.registry import Entry
from envs.experts.counts import read_counts
from envs.tasks import TASKS
from roboverse_learn.commands.columns import columns

WIDTH = 110
HEADINGS = ("task", "source", "expert", "demos", "what to do")
_RIGHT = (3,)
"""Columns of numbers."""

MOST_NAMES_CHARACTERS = 1500
"""A family whose names are longer than this in all is counted; its names are listed on request."""


def tasks_with(words: Sequence[str], datasets_dir: Path) -> str:
    """Returns a table of the tasks that have all of some words: in their name, their words or their source.

    Of a single one it has all other facts of the registry, too.

    Raises:
        ConfigError: No task has them.
    """
    wanted = [word.lower() for word in words]
    found = [entry for entry in map(TASKS.entry, TASKS) if all(word in _text_of(entry) for word in wanted)]
    if not found:
        alone = [word for word in wanted if not any(word in _text_of(TASKS.entry(name)) for name in TASKS)]
        raise ConfigError(
            f"No task has the words {' and '.join(words)}"
            + (f"; none has '{alone[0]}'" if alone else ", though some have each of them")
            + ". All tasks: roboverse list tasks."
        )
    return "\n".join([*_table(found, datasets_dir), *(_facts(found[0]) if len(found) == 1 else ())])


def _facts(entry: Entry) -> list[str]:
    """Returns a line for each fact that a row has no room for, such as the licence."""
    known = {key: value for key, value in entry.info.items() if key not in ("source", "family")}
    facts = {**known, "extra": entry.extra or "none", "tags": ", ".join(sorted(entry.tags))}
    width = max(map(len, facts))
    return [f"    {key.ljust(width)}  {value}" for key, value in sorted(facts.items()) if value]


def _text_of(entry: Entry) -> str:
    return " ".join((entry.name, entry.summary, entry.info.get("source", ""), *entry.tags)).lower()


def tasks_in_detail(datasets_dir: Path) -> str:
    """Returns a table of tasks: source, the expert's success, demonstrations at hand.

    Args:
        datasets_dir: The folder of datasets; those of a task lie in a folder of its name.
    """
    counts = read_counts()
    alone, families = _grouped()
    lines = _table(alone, datasets_dir)
    for name, members in families.items():
        facts = members[0].info
        rates = [counts[entry.name].success_rate for entry in members if entry.name in counts]
        expert = f"{100 * min(rates):.1f} to {100 * max(rates):.1f} %" if rates else "-"
        demos = sum(count_demos(datasets_dir, entry.name) for entry in members)
        lines += [
            f"  {name}, {len(members)} tasks ({facts['source']}; "
            f"expert {expert}, {len(rates)} measured; {demos} demos):",
            _names(members),
        ]
    return "\n".join(lines)


def _table(entries: Sequence[Entry], datasets_dir: Path) -> list[str]:
    counts = read_counts()
    rows: list[tuple[str, ...]] = [HEADINGS]
    for entry in entries:
        unmeasured = "none" if "rl" in entry.tags else "-"
        expert = str(counts.get(entry.name, unmeasured))
        demos = str(count_demos(datasets_dir, entry.name))
        rows.append((entry.name, entry.info.get("source", ""), expert, demos, entry.summary))
    return columns(rows, _RIGHT)


def count_demos(datasets_dir: Path, task: str) -> int:
    """Returns how many demonstrations of a task lie in its datasets, of every level together."""
    return sum(_episodes(info) for info in (datasets_dir / task).glob("*/meta/info.json"))


def _episodes(info: Path) -> int:
    try:
        count = json.loads(info.read_text(encoding="utf-8"))["total_episodes"]
    except (OSError, ValueError, KeyError, TypeError):
        return 0  # commands that read the dataset report what is broken
    return count if isinstance(count, int) else 0


def _grouped() -> tuple[list[Entry], dict[str, list[Entry]]]:
    families: dict[str, list[Entry]] = {}
    for entry in map(TASKS.entry, TASKS):
        families.setdefault(entry.info.get("family", ""), []).append(entry)
    return families.pop("", []), families


def _names(members: list[Entry]) -> str:
    if sum(len(entry.name) for entry in members) > MOST_NAMES_CHARACTERS:
        word = members[0].info["source"].lower()
        return f"    as listed by: roboverse list tasks {word}"
    return textwrap.fill(
        "  ".join(entry.name for entry in members),
        WIDTH,
        initial_indent="    ",
        subsequent_indent="    ",
        break_on_hyphens=False,
        break_long_words=False,
    )
