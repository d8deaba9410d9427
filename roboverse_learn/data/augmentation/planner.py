"""Plans one piece of a generated demonstration: chooses its source, moves its path, follows it by IK.

T_hand(t) = T_object T_object_source⁻¹ T_hand_source(t), after MimicGen (arXiv:2310.17596, section 4). For a
carried object it is the object's own path that is moved to its target: where the hand holds it otherwise than
the source did, the object still reaches the same place.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from envs.kinematics.pose_follower import PoseFollower
from envs.kinematics.waypoints import miss
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.paths import bridged
from roboverse_learn.data.augmentation.pieces import LEAD_M, Piece
from roboverse_learn.data.augmentation.pose import Pose, angle_rad, distance_m
from roboverse_learn.data.augmentation.recording import HandReader, SourceDemo, measured_hand
from roboverse_learn.data.augmentation.references import References

TURN_M_PER_RAD = 0.3
"""Metres that a radian is worth in a comparison of poses. Turning an object turns the whole way to it, which
a wrist's limits allow least."""

MISSED_M, MISSED_RAD = 0.01, 0.1
"""A path is refused when a pose of it is missed by more than this, or was lower than in any source."""

MAX_TRIED = 10
"""Most sources that are tried for a piece until the arm can follow one."""

SELDOM = 3.0
"""How much larger a seldom miss is; see :func:`envs.kinematics.waypoints.miss`."""

HELD_M = 0.03
"""A carried object that is this much farther from the hand than in any source is not held."""

FINAL_HOLD_S = 0.5
"""Time for which the last target is held: a source ends as soon as it has succeeded."""


NOTHING = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
"""The frame of a hand that carries nothing: its path is the hand's own."""


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


@dataclass(frozen=True, eq=False)
class _Way:
    """A piece of a source as numbers.

    Attributes:
        path: What is repeated in the frame of the reference, (L,): the commanded hand, or the object that it
            carries.
        gripper: Targets of the gripper, (L,).
        reference: Pose of the reference.
        lowest_m: Least height of the commanded hand.
        held_m: Distance of the hand from the carried object; None carries nothing.
        free: See :class:`Piece`.
        source: Index of the demonstration.
    """

    path: Pose
    gripper: np.ndarray
    reference: Pose
    lowest_m: float
    held_m: float | None
    free: tuple[int, int]
    source: int

    @classmethod
    def of(cls, demo: SourceDemo, piece: Piece, references: References) -> "_Way":
        """Reads a piece of a demonstration."""
        first = int(piece.steps[0])
        reference = references.pose(demo.states, piece.reference).rows(piece.anchor)
        path, held_m = demo.commanded.rows(piece.steps), None
        if piece.carried:
            held = references.pose(demo.states, piece.carried).rows(first).inverse() @ demo.hand.rows(first)
            path, held_m = path @ held.inverse(), float(np.linalg.norm(held.pos))
        return cls(
            path=reference.inverse() @ path,
            gripper=demo.gripper[piece.steps],
            reference=reference,
            lowest_m=float(demo.commanded.pos[piece.steps, 2].min()),
            held_m=held_m,
            free=piece.free,
            source=demo.index,
        )


class AugmentPlanner:
    """Plans the pieces of an episode one by one, each from the state in which the last one ended.

    It keeps nothing between calls: an episode depends on its random numbers alone.

    Args:
        task: The task.
        sources: Source demonstrations, all with pieces of the same roles.
        config: Settings.

    Attributes:
        roles: Reference, carried object and subtask of each piece.
    """

    def __init__(self, task: Task, sources: Sequence[Source], config: AugmentConfig) -> None:
        scenario = task.scenario
        self._config, self._hz = config, scenario.physics.control_hz
        self._references, self._reader = References(scenario), HandReader.of(task)
        self._driven = list(scenario.robots[0].driven)
        self._follower = PoseFollower(scenario.robots[0])
        self.roles = [piece.role for piece in sources[0].pieces]
        self._ways = [
            [_Way.of(source.demo, source.pieces[stage], self._references) for source in sources]
            for stage in range(len(self.roles))
        ]
        self._firsts = [_stacked([way.path.rows(0) for way in ways]) for ways in self._ways]
        self._floors = [min(way.lowest_m for way in ways) for ways in self._ways]
        self._were = [_stacked([way.reference for way in ways]) for ways in self._ways]

    def plan(
        self, state: State, rng: np.random.Generator, stage: int, last_source: int | None = None
    ) -> PiecePlan:
        """Returns the plan of a piece.

        Args:
            state: The present state, one row.
            rng: Random numbers of the episode.
            stage: Which piece.
            last_source: Source of the piece before; what reached an object grasps it too.
        """
        joints = self._reader.starts(state)[0]
        start, missed = Pose(*self._follower.pose(joints)), self._miss(rng, stage)
        (now, held), best = self._frames(state, stage), None
        order = self._order(rng, stage, start, now, held)
        if stage and self.roles[stage] == self.roles[stage - 1]:
            order = [index for index in order if self._ways[stage][index].source == last_source] or order
        for long_way, index in itertools.product((False, True), order[:MAX_TRIED]):
            way = self._ways[stage][index]
            path = bridged(
                now @ way.path @ held,
                start,
                way.free,
                speed_m_s=self._config.bridge_speed_m_s,
                control_hz=self._hz,
                miss=missed,
                waits=way.held_m is not None,
                long_way=long_way,
            )
            lower = self._floors[stage] - path.pose.pos[:, 2]
            path.pose.pos[:, 2] += np.maximum(lower, 0.0)  # no source went lower: there may be a table
            found = self._follower.follow(joints, *path.pose)
            missed_m = max(float(found.errors_m.max()), float(lower.max()))
            error = max(missed_m / MISSED_M, float(found.errors_rad.max()) / MISSED_RAD)
            if best is None or error < best[0]:
                targets = self._reader.with_gripper(found.targets, way.gripper[path.rows])
                best = error, PiecePlan(self._held_at_end(targets, stage), way.source)
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
        usual = [way.held_m for way in self._ways[stage] if way.held_m is not None]
        now = distance_m(measured_hand(state), self._references.pose(state, carried))[0]
        return bool(now < max(usual) + HELD_M)

    def _frames(self, state: State, stage: int) -> tuple[Pose, Pose]:
        """Returns where a piece's reference is, and the hand in the frame of what it carries."""
        reference, carried, _ = self.roles[stage]
        now = self._references.pose(state, reference).rows(0)
        if not carried:
            return now, NOTHING
        return now, self._references.pose(state, carried).rows(0).inverse() @ measured_hand(state).rows(0)

    def _order(self, rng: np.random.Generator, stage: int, start: Pose, now: Pose, held: Pose) -> list[int]:
        """Returns the sources in the order in which they are tried.

        The nearest is that whose piece must be moved least and begins nearest to the hand.
        """
        count = len(self._ways[stage])
        if self._config.choose == "random":
            return rng.permutation(count).tolist()
        pairs = ((now, self._were[stage]), (start, now @ self._firsts[stage] @ held))
        away = sum(distance_m(*pair) + TURN_M_PER_RAD * angle_rad(*pair) for pair in pairs)
        order = np.argsort(away, kind="stable").tolist()
        drawn = order.pop(int(rng.integers(min(self._config.nearest, count))))
        return [drawn, *order]

    def _held_at_end(self, targets: np.ndarray, stage: int) -> np.ndarray:
        """Returns the targets (T, D) of the driven joints; the last piece's last one is held."""
        hold = round(FINAL_HOLD_S * self._hz) if stage == len(self.roles) - 1 else 0
        held = np.concatenate([targets, np.repeat(targets[-1:], hold, axis=0)])
        return held[:, self._driven].astype(np.float32)

    def _miss(self, rng: np.random.Generator, stage: int) -> np.ndarray:
        """Draws how far the hand first misses, (3,) m; not where it acts on what it has reached."""
        noise, carried = self._config.noise_m, self.roles[stage][1]
        if not noise or not (carried or stage == self.begins_at(stage)):
            return np.zeros(3)
        drawn = rng.normal(0.0, miss(rng, often_m=noise, seldom_m=SELDOM * noise), 3)
        drawn[2] = abs(drawn[2])  # never down into what is there
        return drawn * min(1.0, 0.5 * LEAD_M / float(np.linalg.norm(drawn)))


def _stacked(poses: Sequence[Pose]) -> Pose:
    return Pose(np.stack([pose.pos for pose in poses]), np.stack([pose.rot for pose in poses]))
