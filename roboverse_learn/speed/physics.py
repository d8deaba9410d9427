"""Where the time of mujoco_warp's steps goes, as an agent's exploration sees them.

``python -m roboverse_learn.speed.physics`` steps many worlds of a task under random actions, which
bring the arm into contact, and times control steps with one thing changed at a time: what a change gains is
the most that the thing costs. Then it sums the GPU's time by kernel. On a CPU a few worlds show that the
program works; a CPU's times say little of a GPU's.
"""

import dataclasses
import json
import logging
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np
import torch

from envs.core.arguments import run_program
from envs.scenario import ScenarioCfg

log = logging.getLogger(__name__)

NUM_KERNELS = 20
_PROFILED_STEPS = 10


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class PhysicsBenchmark:
    """``python -m roboverse_learn.speed.physics``.

    Attributes:
        task: Name of a task.
        device: ``auto``, ``cpu``, ``cuda``.
        worlds: Environments; 0 takes 4,096 on a GPU and 4 on a CPU.
        warm_steps: Control steps under random actions before anything is timed; 0 takes 60 on a GPU, 2 on
            a CPU.
        steps: Control steps of one turn; 0 takes 10 on a GPU and 1 on a CPU.
        turns: How often each variant is timed; the median counts.
        out: File for what was measured, as JSON; empty writes none.
    """

    task: str = "PickCube"
    device: str = "auto"
    worlds: int = 0
    warm_steps: int = 0
    steps: int = 0
    turns: int = 3
    out: str = ""


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """One thing that is other than in the task's scene.

    Attributes:
        settings: Settings of the simulator.
        substeps: Physics steps per control step, or None for the task's.
        drawn: Simulate the model that is drawn.
        pruned: Do not look for contacts of links that cannot touch.
        edit: Changes the compiled model.
    """

    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    substeps: int | None = None
    drawn: bool = False
    pruned: bool = True
    edit: Callable[[mujoco.MjModel], None] = lambda model: None


def _iterations(count: int) -> Callable[[mujoco.MjModel], None]:
    def edit(model: mujoco.MjModel) -> None:
        model.opt.iterations = count

    return edit


def _robot_ignores_itself(model: mujoco.MjModel) -> None:
    ours = np.char.startswith([model.geom(index).name for index in range(model.ngeom)], "franka/")
    model.geom_contype[ours & (model.geom_contype > 0)] = 2


def _no_links(model: mujoco.MjModel) -> None:
    for index in range(model.ngeom):
        if model.geom(index).name.startswith("franka/link"):
            model.geom_contype[index] = model.geom_conaffinity[index] = 0


def _no_meshes(model: mujoco.MjModel) -> None:
    meshes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)
    model.geom_contype[meshes] = model.geom_conaffinity[meshes] = 0


def _no_contacts(model: mujoco.MjModel) -> None:
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


VARIANTS = {
    "as it is": Variant(),
    "the drawn model": Variant(drawn=True),
    "looks at all links": Variant(pruned=False),
    "at most 10 iterations": Variant(edit=_iterations(10)),
    "1 iteration (wrong)": Variant(edit=_iterations(1)),
    "128 rows": Variant(settings={"njmax": 128}),
    "robot does not touch itself": Variant(edit=_robot_ignores_itself),
    "links touch nothing": Variant(edit=_no_links),
    "no meshes touch": Variant(edit=_no_meshes),
    "no contacts": Variant(edit=_no_contacts),
    "10 longer steps": Variant(substeps=10),
}
"""The wrong ones are no settings to use: they bound what is to be gained."""


class Loop:
    """Worlds of one variant under random actions.

    Args:
        given: How much is measured.
        variant: What is other.
        num_envs: Worlds.
    """

    def __init__(self, given: PhysicsBenchmark, variant: Variant, num_envs: int) -> None:
        from envs.mjcf.model import build_models
        from envs.simulators import HANDLERS
        from envs.simulators.mujoco_warp.worlds import Worlds
        from envs.tasks import TASKS

        self.task = TASKS.get(given.task)()
        settings = {**variant.settings, "device": given.device}
        scenario: ScenarioCfg = self.task.scenario.tuned("mujoco_warp", settings)
        if variant.substeps is not None:
            scenario = dataclasses.replace(scenario, physics=scenario.physics.divided(variant.substeps))
        build: Any = HANDLERS.get("mujoco_warp")
        self.handler = build(scenario, num_envs)
        self.handler.launch()
        model = self.handler.model if variant.drawn else self.handler.physics_model
        if not variant.pruned:
            model = build_models(scenario)[1]
        variant.edit(model)
        self.model = model
        self.handler.worlds = Worlds(model, num_envs, self.handler.on, self.handler.settings)
        self.decimation = scenario.physics.decimation
        self.controller = self.task.rl_controller
        rngs = [np.random.default_rng(index) for index in range(num_envs)]
        self.handler.set_states(self.task.initial_state(rngs).to(self.handler.device, self.handler.dtype))
        self._generator = torch.Generator().manual_seed(0)
        self._shape = (num_envs, len(self.controller.names))
        self._bias = 0.15 * torch.randn(self._shape, generator=self._generator)

    def run(self, count: int) -> None:
        """Takes control steps under random actions about a mean of each world."""
        for _ in range(count):
            noise = 0.6 * torch.randn(self._shape, generator=self._generator)
            given = (self._bias + noise).clamp(-1.0, 1.0).to(self.handler.device)
            self.controller.advance(self.handler, given, self.decimation)

    def timed(self, count: int, turns: int) -> float:
        """Returns the seconds of a control step."""
        seconds = []
        for _ in range(turns):
            self.handler.on.synchronize()
            started = time.perf_counter()
            self.run(count)
            self.handler.on.synchronize()
            seconds.append((time.perf_counter() - started) / count)
        return median(seconds)

    def kernels(self) -> dict[str, float]:
        """Returns the GPU's milliseconds of a physics step by kernel, the longest first."""
        import mujoco_warp as mjw
        import warp as wp

        worlds, device = self.handler.worlds, self.handler.on
        with device.scope():
            mjw.step(worlds.model, worlds.data)
            wp.timing_begin(cuda_filter=wp.TIMING_ALL)
            for _ in range(_PROFILED_STEPS):
                mjw.step(worlds.model, worlds.data)
            found = wp.timing_end()
        spent: dict[str, float] = {}
        for result in found:
            spent[result.name] = spent.get(result.name, 0.0) + result.elapsed / _PROFILED_STEPS
        return dict(sorted(spent.items(), key=lambda item: -item[1])[:NUM_KERNELS])

    def solver(self) -> dict[str, float]:
        """Returns how hard the last physics step was: iterations of the solver, rows, contacts."""
        data = self.handler.worlds.data
        iterations, rows = data.solver_niter.numpy(), data.nefc.numpy()
        return {
            "iterations, mean": float(iterations.mean()),
            "iterations, largest": float(iterations.max()),
            "rows, mean": float(rows.mean()),
            "rows, largest": float(rows.max()),
            "contacts, mean": float(data.nacon.numpy()[0]) / self.handler.num_envs,
        }


def main(words: Sequence[str] | None = None) -> int:
    """Logs every variant, then the kernels."""
    return run_program("python -m roboverse_learn.speed.physics", PhysicsBenchmark, _measure_all, words)


def _measure_all(given: PhysicsBenchmark) -> int:
    from envs.simulators.mujoco_warp.device import Device

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    on_gpu = Device(given.device).is_cuda
    num_envs = given.worlds or (4096 if on_gpu else 4)
    measured: dict[str, Any] = {"task": given.task, "worlds": num_envs, "variants": {}}
    for name, variant in VARIANTS.items():
        loop = Loop(given, variant, num_envs)
        loop.run(given.warm_steps or (60 if on_gpu else 2))
        seconds = loop.timed(given.steps or (10 if on_gpu else 1), given.turns)
        solver = loop.solver()
        row = {"ms": 1e3 * seconds, "env_steps_per_s": num_envs / seconds, **solver}
        measured["variants"][name] = row
        speed = f"{row['env_steps_per_s']:,.0f}"
        told = ", ".join(f"{key} {value:.1f}" for key, value in solver.items())
        log.info("%-28s %8.2f ms a control step, %10s env steps/s; %s", name, row["ms"], speed, told)
        if name == "as it is" and on_gpu:
            measured["kernels"] = loop.kernels()
        loop.handler.close()
    for name, milliseconds in measured.get("kernels", {}).items():
        log.info("%8.3f ms a physics step: %s", milliseconds, name)
    if given.out:
        path = Path(given.out)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
