"""Training of one policy in several processes against one: ``roboverse speed processes``.

Each side is the training of ``roboverse train preset=gpu`` as ``accelerate launch`` starts it, without
collection and evaluation, on one dataset. Efficiency is the samples per second of all processes over those of
one, per process. Sides run in turns, each in fresh processes; the first steps, in which kernels are still
chosen, are not counted.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessesSettings(Settings):
    """Compares training in several processes, a GPU each, to training in one.

    Attributes:
        parts: act, act_shared, diffusion, diffusion_shared; ``shared`` divides the batch of one.
        num_processes: How many, at least two; as many GPUs are needed, or device=cpu.
        batch_size: Samples of a step of one process alone.
        first_step: Gradient steps that are not counted.
        steps: Gradient steps that are counted.
        turns: How often each side runs.
        words: Further words of ``roboverse train``, as in words=[dataset=mine,image_size=96].
        out: JSON file for the measurements.
    """

    num_processes: int = 2
    batch_size: int = 128
    first_step: int = 100
    steps: int = 200
    turns: int = 2
    words: tuple[str, ...] = ()


def parts(settings: ProcessesSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    each = {name: partial(measure, name, settings, shared=False) for name in POLICIES}
    return each | {f"{name}_shared": partial(measure, name, settings, shared=True) for name in POLICIES}


def measure(policy: str, settings: ProcessesSettings, *, shared: bool) -> Measurement:
    """Compares the seconds of a sample per process: several at once, and one alone.

    Args:
        policy: Which.
        settings: How much.
        shared: Several processes share the batch of one; else each takes as large a batch.

    Raises:
        SimulatorError: Training ended with an error, whose last lines the message has.
    """
    count, batch = settings.num_processes, settings.batch_size
    together = batch if shared else count * batch
    seconds = np.zeros((settings.turns, 2))
    with tempfile.TemporaryDirectory() as folder:
        words = _words(policy, settings, Path(folder))
        for turn in range(settings.turns):
            for side in ((0, 1), (1, 0))[turn % 2]:
                processes, size = ((count, together), (1, batch))[side]
                run = Path(folder) / f"{turn}-{processes}"
                step_s = _step_s(processes, [*words, f"train.batch_size={size}", f"run={run}"], run, settings)
                seconds[turn, side] = step_s * processes / size
    title = f"{policy}, {together} samples a step in {count} processes, {batch} in one: efficiency"
    return measurement(title, seconds, SAME_BATCH_IN_ALL if shared else SAME_BATCH_EACH)


def _words(policy: str, settings: ProcessesSettings, folder: Path) -> list[str]:
    """Returns the words of a training without a time limit; a dataset is collected if none is given."""
    last = settings.first_step + settings.steps
    words = [f"policy={policy}", "task=PickCube", "preset=gpu", "num_demos=20", *settings.words]
    if not any(word.startswith("dataset=") for word in words):
        from roboverse_learn.collect import collect_dataset
        from roboverse_learn.config.compose import compose

        config = compose("train", [*words, f"datasets_dir={folder}"])
        words.append(f"dataset={collect_dataset(config).root}")
    words += [f"train.steps={last}", f"train.save_every={last}", "train.time_limit_s=null"]
    return [*words, f"train.log_every={np.gcd(settings.first_step, last)}"]


def _step_s(num_processes: int, words: Sequence[str], run: Path, settings: ProcessesSettings) -> float:
    """Returns the seconds of a gradient step, by the training's own clock."""
    from roboverse_learn.training.metrics import read_metrics

    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    launch += [f"--nproc_per_node={num_processes}", "-m", "roboverse_learn.speed.one_training", *words]
    on_cpu = {"ACCELERATE_USE_CPU": "true"} if "device=cpu" in words else {}
    done = subprocess.run(launch, env=os.environ | on_cpu, capture_output=True, text=True, check=False)
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.startswith(FAILED)]
        why = said[0].removeprefix(FAILED) if said else done.stderr.strip()[-2000:]
        raise SimulatorError(f"Training in {num_processes} processes failed: {why}")
    elapsed = {row["step"]: row["elapsed_s"] for row in read_metrics(run)}
    return (elapsed[settings.first_step + settings.steps] - elapsed[settings.first_step]) / settings.steps


if __name__ == "__main__":
    sys.exit(program("processes", ProcessesSettings, parts))
