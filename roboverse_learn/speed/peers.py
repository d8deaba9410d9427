"""Control steps of ManiSkill's and robosuite's environments over ours: ``roboverse speed peers``.

One environment on one core, a Panda and a cube at 20 Hz: robosuite's Lift and ManiSkill's PickCube against
our PickCube, with states alone or with an image of one camera at every step. The robot is held where it is
by each project's own controller (robosuite's default, ManiSkill's and our joint targets); ours sways, because
what rests costs our renderer less. Scenes and physics
are those of each project, so the ratio is of what a user waits for and not of equal arithmetic. Times are CPU
time of the process of each side.

Their packages ask for other versions than ours, so each peer may have a Python of its own:
``roboverse speed peers robosuite=/other/venv/bin/python``.
"""

import contextlib
import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from envs.core.errors import MissingExtraError, SimulatorError
from roboverse_learn.speed.harness import NO_GOAL, Goal, Measurement, Program, part

PROGRAM = Path(__file__).with_name("peer_env.py")
ANSWER = "peer_env: "
"""What begins a line of that program."""

TASK = "PickCube"

SWAY_RAD = 0.02
"""How far each joint of our robot goes to and fro."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Peers(Program):
    """Compares a control step to those of ManiSkill 3 and robosuite.

    Attributes:
        parts: maniskill_state, robosuite_state, maniskill_images, robosuite_images.
        maniskill: The Python that has ManiSkill; this one by default.
        robosuite: The Python that has robosuite and a MuJoCo that it works with; this one by default.
        size: Height and width of an image, pixels.
        steps: Control steps of one turn.
        turns: How often each side is timed.
    """

    one_core: ClassVar = True
    environment: ClassVar = {"MUJOCO_GL": "osmesa", "OMP_NUM_THREADS": "1"}

    maniskill: str = sys.executable
    robosuite: str = sys.executable
    size: int = 128
    steps: int = 100
    turns: int = 5

    @part("maniskill_state", "maniskill", "state", Goal(5.0))
    @part("robosuite_state", "robosuite", "state", Goal(6.0))
    @part("maniskill_images", "maniskill", "images", Goal(10.0))
    @part("robosuite_images", "robosuite", "images", Goal(8.0))
    def step(self, peer: str, sees: str, goal: Goal = NO_GOAL) -> Measurement:
        """Compares a step of another project's environment to one of ours; both see states or images."""
        shown = "states" if sees == "state" else f"an image of {self.size}×{self.size}"
        name = f"a step with {shown}, {peer} / ours"
        with Peer(getattr(self, peer), peer, sees, self.size) as theirs, _our_step(sees, self.size) as step:

            def ours() -> None:
                for _ in range(self.steps):
                    step()

            def cpu_s() -> float:
                return time.process_time() + theirs.cpu_s

            other = partial(theirs.step, self.steps)
            return self.compare(name, ours, other, goal, units=self.steps, clock=cpu_s)


class Peer:
    """Another project's environment in a process of its own, with the Python that has its packages.

    Attributes:
        cpu_s: CPU time of its steps so far, seconds.

    Raises:
        MissingExtraError: The environment cannot be made there.
    """

    def __init__(self, python: str, name: str, sees: str, size: int) -> None:
        self.cpu_s = 0.0
        self._name, self._last_words = name, "it says nothing"
        words = [python, str(PROGRAM), name, sees, str(size)]
        pipe, merged = subprocess.PIPE, subprocess.STDOUT
        try:
            self._process = subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=merged, text=True)
        except OSError as error:
            raise MissingExtraError(f"{name}={python} cannot be run: {error.strerror}.") from error
        if self._answer() != "ready":
            self._process.communicate()
            raise MissingExtraError(
                f"{name} does not run with {python}: {self._last_words}. Name the Python of an environment "
                f"in which it does: {name}=<folder>/bin/python"
            )

    def step(self, count: int) -> None:
        """Makes control steps and adds their time to ``cpu_s``.

        Raises:
            SimulatorError: The process ended.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"{count}\n")
        self._process.stdin.flush()
        said = self._answer()
        if not said:
            raise SimulatorError(f"{self._name} ended while it was timed: {self._last_words}.")
        self.cpu_s += float(said)

    def _answer(self) -> str:
        """Returns the next line of the program, without what the packages print; empty once it has ended."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(ANSWER):
                return line.removeprefix(ANSWER).strip()
            self._last_words = line.strip() or self._last_words
        return ""

    def __enter__(self) -> "Peer":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def _our_step(sees: str, size: int) -> Iterator[Callable[[], object]]:
    """Yields what makes a step of our environment."""
    from envs import RoboVerseEnv

    options = {"observation": "state"} if sees == "state" else {"image_size": size, "cameras": ["front"]}
    env = RoboVerseEnv(TASK, split="test", num_threads=1, **options)
    env.reset(seed=0)
    hold = np.array(env.batch.scenario.robots[0].default_qpos, np.float32)
    numbers = itertools.count()

    def step() -> None:
        number = next(numbers)
        if number % env.batch.max_episode_steps == 0:
            env.reset()
        observation, *_ = env.step(hold + SWAY_RAD * np.float32(np.sin(number)))
        if sees == "images":
            assert observation["pixels"]["front"].shape == (size, size, 3)

    with contextlib.closing(env):
        yield step
