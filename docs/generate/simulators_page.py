"""The page of simulators and renderers: what each can and cannot do, how it is installed, how fast it is.

``python -m docs.generate.simulators_page`` writes ``docs/simulators.md`` from the registry and the speeds
beside it; with ``measure=[newton]`` or ``measure=[all]`` those are measured first.
"""

import json
import logging
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.errors import MissingExtraError, SimulatorError
from envs.core.extras import checkout_command
from envs.core.registry import Registry
from envs.simulators import HANDLERS, RENDERERS

logger = logging.getLogger(__name__)

TASK = "PickCube"
IMAGE_SIZE = 128

PAGE = """\
# Simulators and renderers

Made by `python -m docs.generate.simulators_page`. Every simulator passes the same contract tests \
(`tests/contracts/test_handlers.py`), and every renderer its own (`tests/contracts/test_renderers.py`); one \
that is not installed, or finds no driver, is one sentence that says what to install.

`simulator=` chooses physics, `renderer=` images; any pair works: `simulator=mujoco renderer=sapien` has \
MuJoCo's states in SAPIEN's images, and `renderer=` also takes a simulator's name. Each dataset and each \
result names both.

## Simulators

{simulators}

Speed is processor time of one control step (25 physics steps) of one environment of {task}, and of one \
image of {size}×{size} pixels at level 3, on one core, as a multiple of the default's. Bodies with a \
weld or coupled joints (Meta-World) and joints driven by torques need `mujoco` or `mujoco_warp` where the \
table says so; the others refuse such a scene by name. Isaac Sim and CoppeliaSim cannot be installed from \
package indices, and are not here.

## Renderers

What a renderer cannot show is written into its datasets and results, as `not_shown`.

{renderers}

![one scene in every renderer](renderers.png)

The image is made by `python -m docs.generate.simulator_images`.

## From one simulator to another

- `roboverse replay dataset=datasets/{task} simulator=sapien` replays recorded states and controls in \
another simulator; [parity/parity.md](parity/parity.md) is its table.
- `roboverse view task=PickCube level=3 simulator=mujoco` shows an episode in the browser (extra `viewer`): \
a time slider, the scene in 3D, the cameras, the draws. `dataset=…` and `result=…` show recorded ones; \
`file=out.rrd` writes a file.
- `roboverse conservation` measures what each simulator keeps of momentum, angular momentum and kinetic \
energy: [conservation/conservation.md](conservation/conservation.md).
- `roboverse evaluate checkpoint=runs/… simulator=sapien` evaluates a policy where it was not trained. The \
leaderboard keeps simulators and renderers apart: the result is a row of that simulator's tab, labelled with \
where the policy was trained, beside what was trained there.
- `roboverse speed simulators` compares handlers to scripts on the simulator alone.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class PageSettings:
    """Writes the page of simulators and renderers.

    Attributes:
        out: The page; speeds are in the JSON file beside it, of the same name.
        measure: Simulators and renderers whose speed is measured first; ``[all]`` for every one.
    """

    out: Path = Path("docs/simulators.md")
    measure: tuple[str, ...] = ()


def page(speeds: Mapping[str, Mapping[str, float]]) -> str:
    """Returns the page.

    Args:
        speeds: ``control_step_ms`` and ``image_ms``: name to processor time.
    """
    return PAGE.format(
        simulators=_table(
            ("`simulator=`", "what it is", "install", "cannot, or differs", "control step"),
            HANDLERS,
            speeds.get("control_step_ms", {}),
            "mujoco",
        ),
        renderers=_table(
            ("`renderer=`", "what it is", "install", "cannot show", "image"),
            RENDERERS,
            speeds.get("image_ms", {}),
            "warp",
        ),
        task=TASK,
        size=IMAGE_SIZE,
    )


def _table(head: Sequence[str], registry: Registry, speeds: Mapping[str, float], default: str) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name in sorted(registry.names(), key=lambda name: (name != default, name)):
        entry = registry.entry(name)
        install = f"`{checkout_command(entry.extra)}`" if entry.extra else "with the package"
        speed = "not measured"
        if name in speeds and default in speeds:
            speed = f"{speeds[name] / speeds[default]:.2g} ×"
        cannot = entry.info.get("cannot", "") or "nothing"
        lines.append(f"| `{name}` | {entry.summary} | {install} | {cannot} | {speed} |")
    return "\n".join(lines)


def control_step_ms(simulator: str, *, num_steps: int = 40) -> float:
    """Measures processor time of a control step of one environment, ms."""
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    with HANDLERS.get(simulator)(task.scenario, 1, renderer="warp", num_threads=1) as handler:
        handler.launch()
        states = task.initial_state([np.random.default_rng(0)])
        handler.set_states(states)
        target = {task.scenario.robots[0].name: states.robots[task.scenario.robots[0].name].joint_pos}
        decimation = task.scenario.physics.decimation

        def step() -> None:
            handler.step_towards(target, decimation)
            handler.get_states()

        return _processor_ms(step, num_steps)


def image_ms(renderer: str, *, num_images: int = 10) -> float:
    """Measures processor time of an image, ms."""
    import envs

    env = envs.make_vec(
        TASK, 1, level=3, split="train", renderer=renderer, image_size=IMAGE_SIZE, num_threads=1
    )
    try:
        env.reset_envs([0], env.split_indices[:1])
        return _processor_ms(lambda: env.handler.render(env.camera_names[:1]), num_images)
    finally:
        env.close()


def _processor_ms(run: Callable[[], Any], times: int) -> float:
    run()
    started = time.process_time()
    for _ in range(times):
        run()
    return 1000.0 * (time.process_time() - started) / times


def measure(names: Sequence[str], speeds: dict[str, dict[str, float]]) -> None:
    """Measures speeds into ``speeds``; what cannot run here is left out and logged with the reason.

    Raises:
        UnknownNameError: if one is neither a simulator nor a renderer.
    """
    everything = tuple(names) == ("all",)
    for name in names:
        if not everything and name not in RENDERERS:
            HANDLERS.entry(name)
    ways = (("control_step_ms", HANDLERS, control_step_ms), ("image_ms", RENDERERS, image_ms))
    for key, registry, run in ways:
        for name in registry.names():
            if everything or name in names:
                try:
                    speeds.setdefault(key, {})[name] = float(f"{run(name):.3g}")
                except (MissingExtraError, SimulatorError) as error:
                    logger.warning("Left out %s: %s", name, error)


def main(words: Sequence[str] | None = None) -> int:
    """Writes the page of simulators and renderers; returns the exit code."""
    return run_program("python -m docs.generate.simulators_page", PageSettings, _write, words)


def _write(settings: PageSettings) -> None:
    facts = settings.out.with_suffix(".json")
    speeds = json.loads(facts.read_text()) if facts.is_file() else {}
    if settings.measure:
        measure(settings.measure, speeds)
        facts.write_text(json.dumps(speeds, indent=1, sort_keys=True) + "\n")
    settings.out.write_text(page(speeds), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
