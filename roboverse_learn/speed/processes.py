"""Training of one policy in several processes against one: ``roboverse speed processes``.

Each side is the training of ``roboverse train preset=gpu`` as ``accelerate launch`` starts it, without
collection and evaluation, on one dataset. Efficiency is the samples per second of all processes over those of
one, per process. Every side is trained once, in fresh processes, and measured over some rounds of its steps;
the first steps, in which kernels are still chosen, are not counted. All losses are compiled before, at once,
and every process sees its GPU as the first: so each finds its loss in the compiler's cache.
"""

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import NamedTuple

import numpy as np

from envs.core.errors import RoboVerseError, SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Program, measurement, part_each

FAILED = "Training failed: "
"""How the line of a training begins that says why it failed, among those of the launcher."""

PARTS = ("act", "act_shared", "diffusion", "diffusion_shared")
SAME_BATCH_EACH = Goal(0.95)
"""Efficiency where each process takes the batch of one: twice the samples a step."""

SAME_BATCH_IN_ALL = Goal(0.85)
"""Efficiency where the processes share the batch of one."""


class Side(NamedTuple):
    """A policy, how many processes train it, and their samples of a step together."""

    policy: str
    processes: int
    batch: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Processes(Program):
    """Compares training in several processes, a GPU each, to training in one.

    Attributes:
        parts: act, act_shared, diffusion, diffusion_shared; ``shared`` divides the batch of one.
        num_processes: How many, at least two; as many GPUs are needed, or device=cpu.
        batch_size: Samples of a step of one process alone.
        first_step: Gradient steps that are not counted.
        steps: Gradient steps of a round.
        turns: Rounds of each training.
        words: Further words of ``roboverse train``, as in words=[dataset=mine,image_size=96].
    """

    num_processes: int = 2
    batch_size: int = 128
    first_step: int = 100
    steps: int = 100
    turns: int = 2
    words: tuple[str, ...] = ()

    def side(self, part: str) -> Side:
        """Returns what a part trains in several processes."""
        policy, _, shared = part.partition("_")
        return Side(policy, self.num_processes, self.batch_size * (1 if shared else self.num_processes))

    @part_each(*PARTS)
    def efficiency(self, part: str) -> Measurement:
        """Compares the seconds of a sample per process: several at once, and one alone."""
        policy, count, together = side = self.side(part)
        alone = Side(policy, 1, self.batch_size)
        seconds = [step_s(self, each) * each.processes / each.batch for each in (side, alone)]
        name = f"{policy}, {together} samples a step in {count} processes, {alone.batch} in one: efficiency"
        goal = SAME_BATCH_IN_ALL if together == alone.batch else SAME_BATCH_EACH
        return measurement(name, np.stack(seconds, axis=1), goal)

    @property
    def on_cpu(self) -> bool:
        """Whether the words say so."""
        return "device=cpu" in self.words

    def words_of(self, policy: str) -> list[str]:
        """Returns the words of every training of a policy."""
        return [f"policy={policy}", "task=PickCube", "preset=gpu", "num_demos=20", *self.words]

    def start(self, run: Path, side: Side, steps: int, launcher: Sequence[str] = (), gpu: str = "") -> Popen:
        """Starts a training without a time limit, on one GPU if it is named."""
        words = [*self.words_of(side.policy), dataset(self), f"run={run}"]
        words += [f"train.batch_size={side.batch}", "train.time_limit_s=null"]
        words += [f"train.steps={steps}", f"train.save_every={steps}"]
        words += [f"train.log_every={np.gcd(self.first_step, self.steps)}"]
        command = [sys.executable, "-m", *launcher, "roboverse_learn.speed.processes", *words]
        own = {"ACCELERATE_USE_CPU": "true"} if self.on_cpu else {}
        own |= {"CUDA_VISIBLE_DEVICES": gpu} if gpu else {}
        with run.with_suffix(".log").open("w") as log:
            return Popen(command, env=os.environ | own, stdout=DEVNULL, stderr=log)


@cache
def step_s(settings: Processes, side: Side) -> np.ndarray:
    """Returns the seconds of a gradient step in each round, by the training's own clock, (turns,)."""
    from roboverse_learn.training.metrics import read_metrics

    if not settings.on_cpu:
        compile_losses(settings)
    rounds = [settings.first_step + settings.steps * turn for turn in range(settings.turns + 1)]
    launcher = ["torch.distributed.run", "--standalone", f"--nproc_per_node={side.processes}", "-m"]
    if not settings.on_cpu:
        launcher.insert(1, "--virtual-local-rank")
    run = scratch(settings) / f"measure-{side.policy}-in-{side.processes}-of-{side.batch}"
    wait({run: settings.start(run, side, rounds[-1], launcher)})
    elapsed = {row["step"]: row["elapsed_s"] for row in read_metrics(run)}
    return np.diff([elapsed[step] for step in rounds]) / settings.steps


@cache
def compile_losses(settings: Processes) -> None:
    """Puts every loss that is needed into the compiler's cache, spread over the GPUs."""
    sides = [settings.side(part) for part in settings.parts or PARTS]
    batches = [(side.policy, settings.batch_size) for side in sides]
    batches += [(side.policy, side.batch // side.processes) for side in sides]
    started = {}
    for place, (policy, batch) in enumerate(dict.fromkeys(batches)):
        run = scratch(settings) / f"compile-{policy}-of-{batch}"
        gpu = str(place % settings.num_processes)
        started[run] = settings.start(run, Side(policy, 1, batch), 1, gpu=gpu)
    wait(started)


@cache
def dataset(settings: Processes) -> str:
    """Returns the word for the dataset of all trainings, which is collected if the words name none."""
    given = [word for word in settings.words if word.startswith("dataset=")]
    if given:
        return given[-1]
    from roboverse_learn.collect import collect_dataset
    from roboverse_learn.config.compose import compose

    config = compose("train", [*settings.words_of("act"), f"datasets_dir={scratch(settings)}"])
    return f"dataset={collect_dataset(config).root}"


@cache
def scratch(_: Processes) -> Path:
    """Returns a folder for the runs, which is removed when this process ends."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def wait(started: Mapping[Path, Popen]) -> None:
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


def train(words: list[str]) -> None:
    """Trains the policy of a run on its dataset: ``roboverse train`` without collection and evaluation."""
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.device import resolve_device
    from roboverse_learn.training.learners import learner_of
    from roboverse_learn.training.reporter import Reporter

    try:
        config = compose("train", words)
        assert config.run and config.dataset
        learner = learner_of(config, resolve_device(config.device))
        learner.learn(Path(config.run), str(config.dataset), config.seed, Reporter())
    except RoboVerseError as error:
        sys.exit(f"{FAILED}{error}")


if __name__ == "__main__":
    train(sys.argv[1:])
