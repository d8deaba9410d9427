"""A recorded episode of another project, in the terms of one of our tasks.

Shape legend: R = recorded moments, T = control steps, J = joints of our robot.
"""

import contextlib
import xml.etree.ElementTree as ElementTree
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch

from envs.core.errors import DatasetError, RoboVerseError
from envs.rotations import conjugate, from_yaw, multiply, rotate, yaw_of
from envs.scenario import RobotCfg
from envs.state import EntityState, State
from envs.tasks.base import Task

_DAMAGE = (
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ArithmeticError,
    OSError,
    RuntimeError,
    ElementTree.ParseError,
)
"""Errors that come of reading foreign values which are absent, of another kind, or out of range."""


@contextlib.contextmanager
def damage_named(path: Path, name: str = "") -> Iterator[None]:
    """Turns whatever a damaged file raises into an error that names it.

    Args:
        path: The file that is read.
        name: The episode that is read; empty for the file itself.

    Raises:
        DatasetError: Something of the file is absent, of another kind, or out of range.
    """
    try:
        yield
    except RoboVerseError:
        raise
    except _DAMAGE as error:
        what = f"'{name}' of '{path}'" if name else f"'{path}'"
        raise DatasetError(
            f"{what} is incomplete or damaged ({type(error).__name__}: {error}). Download or record it again."
        ) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Demonstration:
    """One episode.

    Attributes:
        name: The episode's name in its file.
        states: The recorded moments, one per row, in float64 and in our world frame: T + 1 of them, or
            the first alone where the file has no more.
        targets: Joint targets of our robot that lead from each moment to the next, (T, J).
        first_state: The moment at which a replay by states begins. An arm jumps from the ones before it.
        succeeded: Whether the file says that the episode succeeded; None where it says nothing.
        facts: JSON-able: how the episode was converted.
    """

    name: str
    states: State
    targets: np.ndarray
    first_state: int = 0
    succeeded: bool | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def has_states(self) -> bool:
        """Whether every moment was recorded, so that a replay by states is possible."""
        return self.states.num_envs > 1


class DemonstrationFile(ABC):
    """One file of demonstrations, opened for one task.

    Attributes:
        format: Name of the format, which is also that of its source.
        suffixes: Ends of such files' names.
        path: The file.
        names: Its episodes.
    """

    format: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    path: Path
    names: tuple[str, ...]

    def __init__(self, path: Path, task: Task) -> None:
        """Opens a file.

        Raises:
            DatasetError: It is absent, damaged, or of another task.
        """
        self.path = path
        with damage_named(path):
            self._open(task)

    def read(self, name: str) -> Demonstration:
        """Reads one episode.

        Raises:
            DatasetError: The episode is damaged; the others may be whole.
        """
        with damage_named(self.path, name):
            return self._read(name)

    @abstractmethod
    def _open(self, task: Task) -> None:
        """Opens ``path`` and sets ``names``; a damaged file may raise what it does."""

    @abstractmethod
    def _read(self, name: str) -> Demonstration:
        """Reads one episode; a damaged one may raise what it does."""

    def close(self) -> None:
        """Releases the file; nothing to do for one that was read whole."""
        return


class SceneMapping(NamedTuple):
    """Mapping of another project's scene to one of our tasks.

    Attributes:
        task: Name of our task.
        objects: Their names of objects to ours.
        task_kwargs: Options that this task needs.
        note: What of it is not the same.
        also: Further tasks of ours that the same recordings show, as they are by default.
    """

    task: str
    objects: Mapping[str, str]
    task_kwargs: Mapping[str, Any] = {}
    note: str = ""
    also: tuple[str, ...] = ()


def check_scene(path: Path, name: str, scenes: Mapping[str, SceneMapping], task: Task) -> SceneMapping:
    """Returns the scene called ``name``, which must be that of the task.

    Raises:
        DatasetError: No task of ours is this scene, or another one is.
    """
    scene = scenes.get(name)
    if scene is None:
        valid = ", ".join(f"{theirs} (our {ours.task})" for theirs, ours in sorted(scenes.items()))
        raise DatasetError(
            f"'{path}' holds episodes of '{name}', and no registered task is the same. Convertible: {valid}."
        )
    if task.name in scene.also:
        return scene._replace(task_kwargs={}, note="")
    options = [f"task_kwargs.{k}={v}" for k, v in scene.task_kwargs.items()]
    words = " or ".join((" ".join((f"task={scene.task}", *options)), *scene.also))
    wrong = [k for k, v in scene.task_kwargs.items() if getattr(task, k, None) != v]
    if task.name != scene.task or wrong:
        raise DatasetError(
            f"'{path}' holds episodes of '{name}', which is not {task.name} with these options. Give {words}."
        )
    return scene


class Placement(NamedTuple):
    """Pose of another scene in ours: rotated about z, then translated.

    Attributes:
        turn: wxyz, (4,).
        shift: m, (3,).
    """

    turn: np.ndarray
    shift: np.ndarray

    def pos(self, pos: np.ndarray) -> np.ndarray:
        """Returns positions (..., 3) in our world."""
        return rotate(self.turn, np.asarray(pos, np.float64)) + self.shift

    def rot(self, rot: np.ndarray) -> np.ndarray:
        """Returns orientations (..., 4), made unit, in our world."""
        rot = np.asarray(rot, np.float64)
        norm = np.linalg.norm(rot, axis=-1, keepdims=True)
        if not np.all(norm > 0.5):
            raise DatasetError("An orientation is not a unit quaternion.")
        return multiply(self.turn, rot / norm)

    def entity(
        self,
        pos: np.ndarray,
        rot: np.ndarray,
        *,
        lin_vel: np.ndarray | None = None,
        ang_vel: np.ndarray | None = None,
        joint_pos: np.ndarray | None = None,
        joint_vel: np.ndarray | None = None,
    ) -> EntityState:
        """Returns the states of one robot or object at R moments.

        Args:
            pos: (R, 3) in the other world.
            rot: (R, 4) in the other world.
            lin_vel: (R, 3) in the other world; zero by default.
            ang_vel: (R, 3) in the entity's own frame; zero by default.
            joint_pos: (R, j).
            joint_vel: (R, j); zero by default.
        """
        state = EntityState.at_rest(self.pos(pos), self.rot(rot), joint_pos)
        if lin_vel is not None:
            state.lin_vel = tensor(rotate(self.turn, np.asarray(lin_vel, np.float64)))
        if ang_vel is not None:
            state.ang_vel = tensor(ang_vel)
        if joint_vel is not None:
            state.joint_vel = tensor(joint_vel)
        return state


def place_base(pos: np.ndarray, rot: np.ndarray, robot: RobotCfg, height_m: float = 0.0) -> Placement:
    """Returns the placement that moves their robot's base to ours, by translation and a rotation about z.

    Args:
        pos: Their base, m, (3,).
        rot: Its orientation, wxyz, (4,).
        robot: Our robot.
        height_m: Height of the plane in their world that is our z = 0.
    """
    turn = from_yaw(yaw_of(np.asarray(robot.rot)) - yaw_of(np.asarray(rot, np.float64)))
    shift = np.asarray(robot.pos) - rotate(turn, np.asarray(pos, np.float64))
    shift[2] = -height_m
    return Placement(turn, shift)


def tensor(values: Any) -> torch.Tensor:
    """Returns float64 values of their own memory as a tensor."""
    return torch.from_numpy(np.array(values, np.float64))


def velocities(positions: np.ndarray, control_hz: float, first: int = 0) -> np.ndarray:
    """Returns how fast something moved when a moment was reached: backward differences, zero at first.

    Args:
        positions: (R, D).
        control_hz: Moments per second.
        first: Moment before which things jump.
    """
    speed = np.zeros_like(positions)
    speed[first + 1 :] = np.diff(positions[first:], axis=0) * control_hz
    return speed


def angular_velocities(rotations: np.ndarray, control_hz: float) -> np.ndarray:
    """Returns backward differences of orientations (R, 4), in the turning body's frame, (R, 3), rad/s."""
    speed = np.zeros((len(rotations), 3))
    step = multiply(conjugate(rotations[:-1]), rotations[1:])
    step *= np.where(step[:, :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(step[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, step[:, :1])
    speed[1:] = step[:, 1:] * (angle / np.maximum(sine, 1e-12)) * control_hz
    return speed


def servo_targets(robot: RobotCfg, joint_pos: np.ndarray, control_hz: float) -> np.ndarray:
    """Returns the targets (R - 1, J) with which our joints go through recorded positions (R, J).

    A joint under position gain kp and damping kd follows its target with a lag of τ = kd / kp (its
    inertia is small beside that). A target u held for a step dt therefore moves q by
    (1 - exp(-dt / τ)) (u - q), which is solved for u.
    """
    lag_s = np.array([joint.kd / joint.kp for joint in robot.joints])
    share = 1.0 - np.exp(-1.0 / (control_hz * np.maximum(lag_s, 1e-6)))
    return within_range(robot, joint_pos[:-1] + np.diff(joint_pos, axis=0) / share)


def within_range(robot: RobotCfg, targets: np.ndarray) -> np.ndarray:
    """Returns targets (T, J) clipped to the joints' ranges."""
    low, high = np.array([joint.range for joint in robot.joints]).T
    return np.clip(targets, low, high)


def assemble(
    robot: RobotCfg,
    joint_pos: np.ndarray,
    targets: np.ndarray,
    objects: Mapping[str, EntityState],
    *,
    joint_vel: np.ndarray | None = None,
) -> State:
    """Returns the states of a whole scene with our robot where its base is bolted.

    Args:
        robot: Our robot.
        joint_pos: (R, J).
        targets: (T, J); a moment holds the target that led to it.
        objects: Our names to R moments.
        joint_vel: (R, J); zero by default.

    Raises:
        DatasetError: A number is not finite, or the lengths differ.
    """
    if len(targets) == 0 or not np.isfinite(targets).all():
        raise DatasetError("Its actions are missing or not finite.")
    entity = EntityState.at_rest(np.asarray(robot.pos), np.asarray(robot.rot), joint_pos)
    count = len(joint_pos)
    for name in ("pos", "rot", "lin_vel", "ang_vel"):
        setattr(entity, name, getattr(entity, name).expand(count, -1).clone())
    if joint_vel is not None:
        entity.joint_vel = tensor(joint_vel)
    entity.joint_target = tensor(np.concatenate([joint_pos[:1], targets])[:count])
    state = State({robot.name: entity}, dict(objects))
    for key, values in state.flatten().items():
        if len(values) != count:
            raise DatasetError(f"'{key}' has {len(values)} moments; the robot has {count}.")
        if not torch.isfinite(values).all():
            row = int(torch.nonzero(~torch.isfinite(values))[0, 0])
            raise DatasetError(f"'{key}' is not finite at moment {row}.")
    return state


def array(values: Any, shape: Sequence[int | None], what: str) -> np.ndarray:
    """Returns ``values`` as a float64 array of a shape; None is any length.

    Raises:
        DatasetError: They are no numbers, not finite, or of another shape.
    """
    try:
        out = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{what} is not an array of numbers: {error}.") from error
    fits = out.ndim == len(shape) and all(w in (None, g) for w, g in zip(shape, out.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise DatasetError(f"{what} has the shape {out.shape}; ({wanted}) is needed.")
    if not np.isfinite(out).all():
        raise DatasetError(f"{what} is not finite at {int(np.argwhere(~np.isfinite(out))[0, 0])}.")
    return out
