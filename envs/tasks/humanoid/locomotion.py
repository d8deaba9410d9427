"""Stand, walk and run, after HumanoidBench (``humanoid_bench/envs/basic_locomotion_envs.py``, MIT).

Sferrazza et al., "HumanoidBench: Simulated Humanoid Benchmark for Whole-Body Locomotion and Manipulation",
RSS 2024. Rewards are products of standing upright, small torques, and the commanded motion, each in [0, 1];
an episode of 1,000 steps is a success if its return reaches the published threshold.

Each is also done by the H1 with two Shadow hands, HumanoidBench's ``h1hand``: the same rewards and bars, with
151 numbers observed and 61 actuators.
"""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from envs.state import State
from envs.tasks.humanoid.task import HumanoidTask

UPRIGHT = 0.9
"""Upward component of the torso's z axis at which the posture has its full reward."""


@dataclass(frozen=True, kw_only=True)
class Stand(HumanoidTask):
    """Stand upright, and do not move."""

    name: ClassVar[str] = "humanoid/stand"
    instructions: ClassVar[tuple[str, ...]] = ("stand upright and keep still",)
    success_return: ClassVar[float | None] = 800.0

    def reward(self, state: State) -> Tensor:
        """Returns standing · upright · small control · not moving, in [0, 1], (N,)."""
        m = self.measures(state)
        return m.small_control * m.standing() * m.straight(UPRIGHT) * m.still


@dataclass(frozen=True, kw_only=True)
class Walk(HumanoidTask):
    """Keep the centre of mass moving forwards at 1 m/s or more, without falling."""

    name: ClassVar[str] = "humanoid/walk"
    instructions: ClassVar[tuple[str, ...]] = ("walk forwards",)
    success_return: ClassVar[float | None] = 700.0
    speed_m_s: ClassVar[float] = 1.0

    def reward(self, state: State) -> Tensor:
        """Returns standing · upright · small control · moving, in [0, 1], (N,)."""
        m = self.measures(state)
        return m.small_control * m.standing() * m.straight(UPRIGHT) * m.moving(self.speed_m_s)


@dataclass(frozen=True, kw_only=True)
class Run(Walk):
    """Keep the centre of mass moving forwards at 5 m/s or more, without falling."""

    name: ClassVar[str] = "humanoid/run"
    instructions: ClassVar[tuple[str, ...]] = ("run forwards",)
    speed_m_s: ClassVar[float] = 5.0


@dataclass(frozen=True, kw_only=True)
class StandWithHands(Stand):
    """Stand upright with hands, and do not move (``h1hand-stand-v0``)."""

    name: ClassVar[str] = "humanoid/h1hand_stand"
    has_hands: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class WalkWithHands(Walk):
    """Walk with hands: keep the centre of mass moving forwards at 1 m/s or more (``h1hand-walk-v0``)."""

    name: ClassVar[str] = "humanoid/h1hand_walk"
    has_hands: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class RunWithHands(Run):
    """Run with hands: keep the centre of mass moving forwards at 5 m/s or more (``h1hand-run-v0``)."""

    name: ClassVar[str] = "humanoid/h1hand_run"
    has_hands: ClassVar[bool] = True
