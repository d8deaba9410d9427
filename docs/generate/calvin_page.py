"""Writes ``docs/howto/calvin.md``: how to run CALVIN's tasks and chains, and how the expert does.

``python -m docs.generate.calvin_page`` reads ``results/tasks.json``, which ``python -m envs.experts.survey``
writes, and ``results/calvin_chains.json``, which ``roboverse evaluate suite=calvin chains=1000`` writes.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmark.calvin_chains import ChainScores
from benchmark.chain_results import read_results
from envs.core.atomic import write_file
from envs.experts.counts import read_rows
from envs.tasks.calvin.catalogue import SCENES, Entry, task_facts
from envs.tasks.calvin.sequences import all_chains

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "calvin.md"
RESULTS = ROOT / "results" / "tasks.json"
CHAINS = ROOT / "results" / "calvin_chains.json"

BAR = 0.8
"""Success rate at which a task counts."""

TEXT = """# Run CALVIN's tasks and chains

CALVIN (Mees et al., [arXiv:2112.03227](https://arxiv.org/abs/2112.03227)) has 34 tasks at a play table with a sliding
door, a drawer, a switch, a button and three blocks, in four scenes, A to D. A policy is trained in A to C, or in D, and
tested in D, on chains of five instructions.

![The four scenes; below, how each instruction of a chain ends](calvin.jpg)

```bash
roboverse list tasks calvin drawer
roboverse train policy=act task=calvin/D/open_drawer preset=quick
roboverse evaluate policy=expert suite=calvin
roboverse assets get calvin        # for task_kwargs.looks=meshes: 17 MB, MIT
```

Tasks are called `calvin/<scene>/<task>`. `suite=calvin` has the 34 of scene D, `suite=calvin_abc` the 102 of the others.

## What is CALVIN's, and what is ours

| | |
|---|---|
| scenes | CALVIN's tables, blocks, places and surfaces. What collides is boxes of the meshes' dimensions, so no download is needed; `task_kwargs.looks=meshes` renders CALVIN's meshes and textures |
| robot | Franka Panda at CALVIN's place and posture, with the Franka hand. CALVIN's fingers are 4.5 cm longer |
| cameras | `static`, 200 pixels, at CALVIN's pose, and `gripper`, 84 pixels and 75 degrees, at our wrist camera's pose |
| success | CALVIN's rules, to the letter: what has changed since the episode began. Contacts are those of bodies; what the robot touches beside blocks does not count |
| starts | symbolic states of CALVIN's evaluation in which the task can be done. In scene D places are those of the evaluation; in the others they are drawn from the scene's surfaces. A block may start in the hand, in the drawer or on another one. `task_kwargs.starts=chain` begins four of five episodes in scene D where another task of a chain has just ended ([below](#demonstrations-for-chains)) |
| instruction | the sentence of CALVIN's evaluation |
| horizon | 360 steps at 30 Hz |
| masses and friction | those of CALVIN's blocks. Friction of door, drawer, switch and button is chosen so that they stay where they are left |
| lights | the LED shows how an episode began; in a chain both lights follow |

How an episode began is part of its states, in markers that are not seen: a recorded state can be set, and judged, in any
simulator that reports contacts (`mujoco`, `mujoco_warp`); others refuse with a sentence that says so.

## CALVIN's own interface

`roboverse evaluate checkpoint=runs/<run> suite=calvin protocol=calvin` sets these; each can be set alone:

| key | value |
|---|---|
| `task_kwargs.action_space` | `native`: x, y, z, roll, pitch, yaw of the hand's target, 2 cm and 0.05 rad at most, and the gripper, 1 or -1 |
| `task_kwargs.observation_space` | `native`: the 15 numbers of `robot_obs` |
| `task_kwargs.looks` | `meshes` |
| `cameras` | `[static,gripper]` |

## Chains of five instructions

```bash
roboverse evaluate policy=expert suite=calvin chains=1000
roboverse evaluate checkpoint=outputs/<run>/pretrained_model suite=calvin chains=1000 protocol=calvin
```

The 1,000 chains, and the state in which each begins, are the authors': the same rules and random numbers, compared one by
one. Each instruction has 360 steps and begins where the last one ended. Results are kept chain by chain in
`results/calvin_chains.json`; the same command resumes after an interruption, and `first_chain=200 chains=100` runs a part.
A policy sees the cameras and the image size that it learned from. One that learned the scene's tasks from the
expert's demonstrations acts in joints: [train it](multi_task.md#libero-and-calvin-on-one-gpu), and leave out `protocol=calvin`.
The board has every policy that ran chains; [Results](../results.md#calvins-chains) says more of ours. Its first chain, in
`mujoco` (`python -m docs.generate.calvin_gif checkpoint=runs/mtact_calvin`):

![A network follows five instructions](calvin_chain.gif)
"""  # noqa: E501

FOR_CHAINS = """## Demonstrations for chains

In a chain an instruction begins where the last one ended: at a handle, above a block, with a block in the hand. A policy
whose demonstrations all begin in the arm's own posture has never seen that. With `task_kwargs.starts=chain` a fifth of
the episodes of a task begin with the arm in its own posture, and the others where another task of a chain has just ended
and this one is possible, by the symbols of the state, its contacts and its lights:

```bash
roboverse collect suite=calvin task_kwargs.starts=chain num_demos=100
python -m benchmark.calvin_states out=states.npz     # how the recorded states were made, in ten minutes of one CPU core
```

The recorded states are those in which the expert ended the tasks of 600 chains, drawn by the authors' rule in scene D with
CALVIN's own robot; none is one of the evaluation's, though three have the tasks of one, from another start. Train and test episodes of `starts=chain` draw from the same ones: what is new to a policy is in
the chains of the evaluation."""  # noqa: E501

EXPERT = """One expert solves all tasks: it makes a plan of skills from the task's rule, and from whatever state it is
asked in, and plans again after a miss. It pushes as CALVIN's rule allows: it carries a block along, just above the
desk."""  # noqa: E501


def page(rows: Mapping[str, Mapping[str, Any]], chains: Mapping[int, int]) -> str:
    """Returns the page in Markdown.

    Args:
        rows: Task to its row of ``results/tasks.json``.
        chains: Index of a chain to how many of its tasks the expert solved.
    """
    parts = [TEXT.rstrip()]
    if chains:
        order = sorted(chains)
        tasks = tuple(all_chains()[index][1] for index in order)
        scores = ChainScores(tuple(chains[index] for index in order), tasks)
        rates = " | ".join(f"{100 * rate:.1f} %" for rate in scores.rates)
        parts.append(
            f"The expert, in {len(order)} of the chains: average length "
            f"**{scores.average_length:.2f}** of 5.\n\n"
            f"| in a row | 1 | 2 | 3 | 4 | 5 |\n|---|---|---|---|---|---|\n| chains | {rates} |"
        )
    parts.append(FOR_CHAINS)
    counts = {scene: _counted(rows, scene) for scene in SCENES}
    good = {scene: sum(row["expert"] >= BAR for row in own.values()) for scene, own in counts.items()}
    lines = ["| task | instruction | expert | starts |", "|---|---|---|---|"]
    for task, facts in task_facts().items():
        row = counts["D"].get(task)
        starts = "" if row is None else row["episodes"]
        lines.append(f"| {Entry('D', task).name} | {facts.instruction} | {_rate(row)} | {starts} |")
    parts += [
        "## The expert",
        EXPERT,
        "```bash\npython -m envs.experts.survey words=[calvin/D/] episodes=20\n"
        "python -m docs.generate.calvin_page\n```",
        f"{len(counts['D'])} of 34 tasks are counted in scene D; the expert reaches {100 * BAR:.0f} % in "
        f"{good['D']} of them.",
        "\n".join(lines),
    ]
    others = [scene for scene in SCENES if scene != "D" and counts[scene]]
    if others:
        heads = " | ".join(others)
        table = [f"| task | {heads} |", "|---|" + "---|" * len(others)]
        for task in task_facts():
            rates = " | ".join(_rate(counts[scene].get(task)) for scene in others)
            table.append(f"| {task} | {rates} |")
        parts += [
            "In the other scenes, with `words=[calvin/A/]`, `[calvin/B/]` or `[calvin/C/]` in that command,\n"
            f"it reaches {100 * BAR:.0f} % in "
            + ", ".join(f"{good[scene]} of {len(counts[scene])} in {scene}" for scene in others)
            + ":",
            "\n".join(table),
        ]
    return "\n\n".join(parts) + "\n"


def _counted(rows: Mapping[str, Mapping[str, Any]], scene: str) -> dict[str, Mapping[str, Any]]:
    """Returns the rows of a scene's tasks that are counted, by task."""
    named = {task: rows.get(Entry(scene, task).name, {}) for task in task_facts()}
    return {task: row for task, row in named.items() if row.get("episodes")}


def _rate(row: Mapping[str, Any] | None) -> str:
    return "not counted" if row is None else f"{100 * row['expert']:.0f} %"


if __name__ == "__main__":
    write_file(PAGE, page(read_rows(RESULTS), read_results(CHAINS).get("expert", {})).encode())
    sys.exit(0)
