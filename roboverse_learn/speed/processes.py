"""Training of one policy in several processes against one: ``roboverse speed processes``.

Each side is the training of ``roboverse train preset=gpu`` as ``accelerate launch`` starts it, without
collection and evaluation, on one dataset. Efficiency is the samples per second of all processes over those of
one, per process. Every side is trained once, in fresh processes, and measured over some rounds of its steps;
the first steps, in which kernels are still chosen, are not counted. All losses are compiled before, at once,
and every process sees its GPU as the first: so each finds its loss in the compiler's cache.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Settings, measurement, program
from roboverse_learn.speed.one_training import FAILED

POLICIES = ("act", "diffusion")
SAME_BATCH_EACH = Goal(0.95)
"""Efficiency where each process takes the batch of one: twice the samples a step."""

SAME_BATCH_IN_ALL = Goal(0.85)
"""Efficiency where the processes share the batch of one."""

PARTS = tuple(f"{policy}{'_shared' * shared}" for policy in POLICIES for shared in (False, True))

type Side = tuple[str, int, int]
"""A policy, how many processes train it, and their samples of a step together."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessesSettings(Settings):
    """Compares training in several processes, a GPU each, to training in one.

    Attributes:
        parts: act, act_shared, diffusion, diffusion_shared; ``shared`` divides the batch of one.
        num_processes: How many, at least two; as many GPUs are needed, or device=cpu.
        batch_size: Samples of a step of one process alone.
        first_step: Gradient steps that are not counted.
        steps: Gradient steps of a round.
        turns: Rounds of each training.
        words: Further words of ``roboverse train``, as in words=[dataset=mine,image_size=96].
        out: JSON file for the measurements; it grows with each.
    """

    num_processes: int = 2
    batch_size: int = 128
    first_step: int = 100
    steps: int = 100
    turns: int = 2
    words: tuple[str, ...] = ()


def parts(settings: ProcessesSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    trainings = Trainings(settings)
    return {part: partial(measure, part, trainings) for part in PARTS}


def measure(part: str, trainings: "Trainings") -> Measurement:
    """Compares the seconds of a sample per process: several at once, and one alone.

    Args:
        part: Of :data:`PARTS`. In those that are shared, several processes share the batch of one; in the
            others each takes as large a batch.
        trainings: Measures them.

    Raises:
        SimulatorError: Training ended with an error, whose last lines the message has.
    """
    policy, _, shared = part.partition("_")
    count, batch = trainings.settings.num_processes, trainings.settings.batch_size
    together = batch if shared else count * batch
    sides = ((count, together), (1, batch))
    seconds = np.stack(
        [trainings.step_s(policy, processes, size) * processes / size for processes, size in sides], axis=1
    )
    title = f"{policy}, {together} samples a step in {count} processes, {batch} in one: efficiency"
    return measurement(title, seconds, SAME_BATCH_IN_ALL if shared else SAME_BATCH_EACH)


class Trainings:
    """The trainings that are compared, each of which is run once.

    Args:
        settings: How much.
    """

    def __init__(self, settings: ProcessesSettings) -> None:
        self.settings = settings
        self._folder = Path(tempfile.mkdtemp())
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._known: dict[Side, np.ndarray] = {}
        self._on_cpu = "device=cpu" in settings.words

    def step_s(self, policy: str, processes: int, batch: int) -> np.ndarray:
        """Returns the seconds of a gradient step in each round, by the training's own clock, (turns,).

        Raises:
            SimulatorError: Training ended with an error, whose last lines the message has.
        """
        from roboverse_learn.training.metrics import read_metrics

        key = policy, processes, batch
        if key not in self._known:
            assert self._compiled
            settings = self.settings
            rounds = [settings.first_step + settings.steps * turn for turn in range(settings.turns + 1)]
            run = self._run(key)
            launch = ["torch.distributed.run", "--standalone", f"--nproc_per_node={processes}", "-m"]
            launch[1:1] = [] if self._on_cpu else ["--virtual-local-rank"]
            self._wait({run: self._start(launch, key, run, rounds[-1])})
            elapsed = {row["step"]: row["elapsed_s"] for row in read_metrics(run)}
            self._known[key] = np.diff([elapsed[step] for step in rounds]) / settings.steps
        return self._known[key]

    @cached_property
    def _compiled(self) -> bool:
        """True once every loss that is needed is in the compiler's cache."""
        count, batch = self.settings.num_processes, self.settings.batch_size
        needed: dict[Side, None] = {}
        for part in self.settings.parts or PARTS:
            policy, _, shared = part.partition("_")
            needed |= dict.fromkeys([(policy, 1, batch), *([(policy, 1, batch // count)] if shared else [])])
        if not self._on_cpu:
            runs = {self._run(key, "compile"): key for key in needed}
            self._wait(
                {
                    run: self._start([], key, run, 1, {"CUDA_VISIBLE_DEVICES": str(place % count)})
                    for place, (run, key) in enumerate(runs.items())
                }
            )
        return True

    def _run(self, key: Side, purpose: str = "measure") -> Path:
        policy, processes, batch = key
        return self._folder / f"{purpose}-{policy}-in-{processes}-of-{batch}"

    @cached_property
    def _dataset(self) -> str:
        """The dataset of all trainings; it is collected if the words name none."""
        given = [word for word in self.settings.words if word.startswith("dataset=")]
        if given:
            return given[-1]
        from roboverse_learn.collect import collect_dataset
        from roboverse_learn.config.compose import compose

        config = compose("train", [*self._words(POLICIES[0]), f"datasets_dir={self._folder}"])
        return f"dataset={collect_dataset(config).root}"

    def _words(self, policy: str) -> list[str]:
        return [f"policy={policy}", "task=PickCube", "preset=gpu", "num_demos=20", *self.settings.words]

    def _start(
        self,
        launch: list[str],
        key: Side,
        run: Path,
        steps: int,
        env: Mapping[str, str] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Starts a training without a time limit."""
        policy, _, batch = key
        words = [*self._words(policy), self._dataset, f"run={run}", f"train.batch_size={batch}"]
        words += [f"train.steps={steps}", f"train.save_every={steps}", "train.time_limit_s=null"]
        words += [f"train.log_every={np.gcd(self.settings.first_step, self.settings.steps)}"]
        modules = [*launch, "roboverse_learn.speed.one_training"]
        own = {"ACCELERATE_USE_CPU": "true"} if self._on_cpu else {}
        with run.with_suffix(".log").open("w") as log:
            return subprocess.Popen(
                [sys.executable, "-m", *modules, *words],
                env=os.environ | own | dict(env or {}),
                stdout=subprocess.DEVNULL,
                stderr=log,
            )

    def _wait(self, started: Mapping[Path, subprocess.Popen[bytes]]) -> None:
        """Waits for trainings by their runs.

        Raises:
            SimulatorError: One ended with an error.
        """
        for run, training in started.items():
            if training.wait():
                text = run.with_suffix(".log").read_text()
                said = [line for line in text.splitlines() if line.startswith(FAILED)]
                why = said[0].removeprefix(FAILED) if said else text.strip()[-2000:]
                raise SimulatorError(f"The training {run.name} failed: {why}")


if __name__ == "__main__":
    sys.exit(program("processes", ProcessesSettings, parts))
