"""Plans one piece of a generated demonstration: chooses its source, moves its path, follows it by IK."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint, miss
from envs.rotations import conjugate, multiply, to_euler
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.paths import HandPath, bridged, moved
from roboverse_learn.data.augmentation.pieces import LEAD_M, Piece
from roboverse_learn.data.augmentation.pose import Pose, angle_rad, distance_m
from roboverse_learn.data.augmentation.recording import HandReader, SourceDemo, measured_hand
from roboverse_learn.data.augmentation.references import References

TURN_M_PER_RAD = 0.3
"""Metres that a radian is worth in a comparison of poses. Turning an object turns the whole way to it, which a
wrist's limits allow least."""

MISSED_M, MISSED_RAD = 0.01, 0.1
"""A path is refused when inverse kinematics misses a pose of it by more than this."""

SELDOM = 3.0
"""How much larger a seldom miss is; see :func:`envs.kinematics.waypoints.miss`."""

HELD_M = 0.03
"""A carried object that is this much farther from the hand than in the source is not held."""

FINAL_HOLD_S = 0.5
"""Time for which the last target is held: a source ends as soon as it has succeeded."""


@dataclass(frozen=True, eq=False)
class Source:
    """A source demonstration with its pieces.

    Attributes:
        demo: The demonstration.
        pieces: Its pieces; those of all sources have the same roles.
    """

    demo: SourceDemo
    pieces: tuple[Piece, ...]


class PiecePlan(NamedTuple):
    """A plan of one piece.

    Attributes:
        targets: Joint targets, (T, D) float32.
        source: Index in its dataset of the demonstration that it is made from.
    """

    targets: np.ndarray
    source: int


class AugmentPlanner:
    """Plans the pieces of an episode one by one, each from the state in which the last one ended.

    It keeps nothing between calls: an episode depends on its random numbers alone.

    Args:
        task: The task.
        sources: Source demonstrations, all with pieces of the same roles.
        config: Settings.
    """

    def __init__(self, task: Task, sources: Sequence[Source], config: AugmentConfig) -> None:
        scenario = task.scenario
        self._sources, self._config = sources, config
        self._hz = scenario.physics.control_hz
        self._references, self._reader = References(scenario), HandReader(task)
        self._robot = scenario.robots[0]
        self._driven = list(self._robot.driven)
        self._follower = PathFollower(self._robot, self._hz)
        self.roles = [piece.role for piece in sources[0].pieces]
        self._objects = {
            (index, name): self._references.pose(source.demo.states, name)
            for index, source in enumerate(sources)
            for name in {name for piece in source.pieces for name in (piece.reference, piece.carried) if name}
        }

    def plan(self, state: State, rng: np.random.Generator, stage: int) -> PiecePlan:
        """Returns the plan of a piece.

        Args:
            state: The present state, one row.
            rng: Random numbers of the episode.
            stage: Which piece.
        """
        start = self._reader.hands(self._reader.starts(state)).rows(0)
        missed = self._miss(rng)
        best: tuple[float, PiecePlan] | None = None
        for index in self._order(state, rng, stage, start):
            source = self._sources[index]
            path = self._path(index, state, stage, start, missed)
            targets = self._follow(state, source, stage, path)
            error = self._error(targets, path.pose)
            if best is None or error < best[0]:
                best = error, PiecePlan(targets[:, self._driven].astype(np.float32), source.demo.index)
            if error <= 1.0:
                break
        assert best is not None, "there is a source"
        return best[1]

    def begins_at(self, stage: int) -> int:
        """Returns the first piece of the subtask that a piece belongs to."""
        subtask = self.roles[stage][2]
        return next(index for index, role in enumerate(self.roles) if role[2] == subtask)

    def holds(self, state: State, stage: int) -> bool:
        """Whether the hand holds what a piece carries; true for a piece that carries nothing."""
        carried = self.roles[stage][1]
        if not carried:
            return True
        now = distance_m(measured_hand(state), self._references.pose(state, carried))[0]
        usual = []
        for index, source in enumerate(self._sources):
            held = self._held(index, stage)
            usual.append(float(np.linalg.norm(held.pos)))
            del source
        return bool(now < max(usual) + HELD_M)

    def _order(self, state: State, rng: np.random.Generator, stage: int, start: Pose) -> list[int]:
        """Returns the sources in the order in which they are tried."""
        count = len(self._sources)
        if self._config.choose == "random":
            return [int(index) for index in rng.permutation(count)]
        away = [self._difference(index, state, stage, start) for index in range(count)]
        order = [int(index) for index in np.argsort(away, kind="stable")]
        drawn = int(rng.integers(min(self._config.nearest, count)))
        return [order[drawn], *(index for index in order if index != order[drawn])]

    def _difference(self, index: int, state: State, stage: int, start: Pose) -> float:
        """Returns by how much a source's piece must be moved, and how far its beginning is, m."""
        piece = self._sources[index].pieces[stage]
        was = self._objects[index, piece.reference].rows(piece.first)
        now = self._references.pose(state, piece.reference).rows(0)
        first = self._moved(index, state, stage).rows(0)
        pairs = ((was, now), (first, start))
        return sum(float(distance_m(*pair)) + TURN_M_PER_RAD * float(angle_rad(*pair)) for pair in pairs)

    def _moved(self, index: int, state: State, stage: int) -> Pose:
        """Returns a source's path of a piece, moved with its object, (T,)."""
        source, piece = self._sources[index], self._sources[index].pieces[stage]
        path = source.demo.commanded.rows(slice(piece.first, piece.last))
        held = None
        if piece.carried:
            carried = self._references.pose(state, piece.carried).rows(0)
            held = self._held(index, stage), carried.inverse() @ measured_hand(state).rows(0)
        was = self._objects[index, piece.reference].rows(piece.first)
        return moved(path, was, self._references.pose(state, piece.reference).rows(0), held)

    def _held(self, index: int, stage: int) -> Pose:
        """Returns the hand in the carried object's frame when a source's piece begins."""
        source, piece = self._sources[index], self._sources[index].pieces[stage]
        carried = self._objects[index, piece.carried].rows(piece.first)
        return carried.inverse() @ source.demo.hand.rows(piece.first)

    def _path(self, index: int, state: State, stage: int, start: Pose, missed: np.ndarray) -> HandPath:
        piece = self._sources[index].pieces[stage]
        path = self._moved(index, state, stage)
        if piece.free == (0, 0) and not piece.carried and stage != self.begins_at(stage):
            missed = np.zeros(3)  # the hand is at the object already
        return bridged(path, start, piece.free, self._config.bridge_speed_m_s, self._hz, missed)

    def _follow(self, state: State, source: Source, stage: int, path: HandPath) -> np.ndarray:
        """Returns joint targets (T, J) along a path, with the gripper of the source."""
        turns = to_euler(multiply(path.pose.rot, conjugate(self._reader.rest_rot)))
        fingers = source.demo.gripper[source.pieces[stage].first + path.steps]
        ways = [
            Waypoint(
                pos=pos, yaw=turn[0], pitch=turn[1], roll=turn[2], gripper=grip, duration_s=1.0 / self._hz
            )
            for pos, turn, grip in zip(path.pose.pos, turns, fingers, strict=True)
        ]
        targets = self._follower.joint_targets(self._reader.starts(state)[0], ways)
        if stage == len(self.roles) - 1:
            hold = round(FINAL_HOLD_S * self._hz)
            targets = np.concatenate([targets, np.repeat(targets[-1:], hold, axis=0)])
        return targets

    def _error(self, targets: np.ndarray, path: Pose) -> float:
        """Returns the largest error of the targets' hand; more than 1 is too much."""
        hands = self._reader.hands(targets[: len(path.pos)])
        away, turned = distance_m(hands, path).max(), angle_rad(hands, path).max()
        return float(max(away / MISSED_M, turned / MISSED_RAD))

    def _miss(self, rng: np.random.Generator) -> np.ndarray:
        """Draws how far the hand first misses, (3,) m; never into what it comes to."""
        noise = self._config.noise_m
        if not noise:
            return np.zeros(3)
        drawn = rng.normal(0.0, miss(rng, often_m=noise, seldom_m=SELDOM * noise), 3)
        return drawn * min(1.0, 0.5 * LEAD_M / float(np.linalg.norm(drawn)))
