"""Puts another robot into a task: where its base stands, and the posture in which its hand starts.

The hand of every robot starts where the hand of the task's own robot does, and follows the same waypoints.
The base may move within :data:`BASE_MOVES_M`; the nearest place is taken from which inverse kinematics
reaches the start and the expert's ways of some episodes, in the posture in which the arm touches least on the
way. A robot that cannot is refused, with what it lacks.

Shapes: C places of the base, P postures, E episodes, T control steps, K joints of the arm.
"""

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, MissingAssetError
from envs.kinematics.batched_inverse import BatchedInverseKinematics
from envs.kinematics.forward import rotation_vector
from envs.kinematics.waypoints import Waypoint, interpolate
from envs.rotations import conjugate, from_euler, from_matrix, multiply, to_euler, to_matrix
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.arm_contacts import ArmContacts
from envs.tasks.base import Task
from envs.tasks.kept_fits import fit_file, keep_fit, read_fit

BASE_MOVES_M: tuple[tuple[float, ...], ...] = (
    (0.0, 0.06, 0.11, 0.16, -0.06, -0.11),
    (0.0, -0.08, 0.08),
    (0.0, -0.1, 0.1),
)
"""What may be added to the place of the task's own base along x, which points to the workspace, y and z."""

_VERSION = 1
"""Raised when the search finds other places; those that are kept are then found again."""

NUM_EPISODES = 32
"""Episodes whose ways must be reachable."""

NUM_SEEDS, NUM_POSTURES = 32, 4
"""Postures from which the start is looked for, and of those found how many are followed along the ways."""

REST_ITERATIONS = 50

WAY_HZ, WAY_ITERATIONS = 10.0, 4
"""Poses per second at which ways are followed here, and steps of inverse kinematics for each."""

TOGETHER = (1, 5, 12, 36)
"""How many places of the base are tried at once: most robots need not move."""

POSITION_TOLERANCE_M, TURN_TOLERANCE_RAD = 0.004, 0.03
"""A pose is reached when it is missed by less: a grasp forgives a few millimetres."""

MOST_SPEED_RAD_S = 5.0
"""Largest speed of a joint; a wrist that flips over needs more."""


TOUCH_EPISODES, TOUCH_EVERY = NUM_EPISODES, 3
"""Contacts of the arm are looked for in as many episodes, in every third pose of their ways."""

FREE_SHARE = 0.002
"""Share of poses with contacts that passes for none: a lid that is pushed is where it was no more."""

MOST_CHECKED = 8
"""Most places and postures whose contacts are counted."""


@dataclass(frozen=True, slots=True)
class _Ways:
    """Starts, the pose of the hand at rest, and paths of the hand in the world.

    Attributes:
        starts: Initial states, E rows.
        rest: Position (3,) and orientation (3, 3).
        pos: Positions, (E, T, 3).
        rot: Orientations, (E, T, 3, 3).
    """

    starts: State
    rest: tuple[Tensor, Tensor]
    pos: Tensor
    rot: Tensor


@dataclass(frozen=True, slots=True)
class _Tries:
    """Places of the base that were tried.

    Attributes:
        moves: What was added to the base, m, (C, 3).
        rest: Postures at rest, (C, P, K).
        missed: Largest miss of a pose, m, (C, P).
        turned: Largest miss of an orientation, rad, (C, P).
        fastest: Largest speed of a joint, rad/s, (C, P).
        ways: Postures on the ways, every few poses, (T', C, P, E, K).
    """

    moves: Tensor
    rest: Tensor
    missed: Tensor
    turned: Tensor
    fastest: Tensor
    ways: Tensor

    def good(self) -> list[tuple[int, int]]:
        """Returns places and postures that reach everything: near places first, then natural postures."""
        reached = (self.missed < POSITION_TOLERANCE_M) & (self.turned < TURN_TOLERANCE_RAD)
        return [tuple(pair) for pair in (reached & (self.fastest < MOST_SPEED_RAD_S)).nonzero().tolist()]

    def nearest(self) -> tuple[float, float, float]:
        """Returns the misses, m and rad, and the speed of the try that misses least."""
        least = int((self.missed + 0.1 * self.turned).argmin())
        off, turn, speed = (float(v.flatten()[least]) for v in (self.missed, self.turned, self.fastest))
        return off, turn, speed


def fitted(task: Task, robot: RobotCfg) -> RobotCfg:
    """Returns a robot where it can do a task: with its base, and with the posture of its start.

    Args:
        task: The task, with its own robot.
        robot: Another robot, with any base and rest posture; near the latter the start is looked for.

    Raises:
        ConfigError: It has no gripper, or cannot reach the start or the expert's ways from anywhere within
            the bounds.
    """
    check_arm(task, robot)
    return _fitted(type(task), tuple(sorted(_options(task).items())), robot)


def check_arm(task: Task, robot: RobotCfg) -> None:
    """Refuses a robot that has no gripper, or whose base moves.

    Raises:
        ConfigError: It does.
    """
    if not robot.gripper_joints or not robot.fixed_base:
        raise ConfigError(
            f"The robot '{robot.name}' cannot do {task.name}: it is no arm with a gripper. "
            "See those that are with: roboverse list robots"
        )


def _options(task: Task) -> dict[str, object]:
    import dataclasses

    values = ((item.name, getattr(task, item.name)) for item in dataclasses.fields(task))  # pyright: ignore[reportArgumentType]
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values}


@lru_cache(maxsize=64)
def _fitted(cls: type[Task], options: tuple[tuple[str, object], ...], robot: RobotCfg) -> RobotCfg:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the matrices are small: threads only wait for each other
    try:
        return _search(cls(**dict(options)), robot)
    finally:
        torch.set_num_threads(threads)


def _search(task: Task, robot: RobotCfg) -> RobotCfg:
    """Returns the robot in its place, as it was found before or is found now."""
    ways = _ways(task)
    hand = [ways.pos.numpy(), ways.rot.numpy(), *(part.numpy() for part in ways.rest)]
    path = fit_file(_VERSION, [robot, task.robot, task.scenario.objects, task.scenario.table], hand)
    kept = read_fit(path)
    if kept is None:
        try:
            placed = _found(task, robot, ways)
        except MissingAssetError:  # says nothing about the robot
            raise
        except ConfigError as error:
            keep_fit(path, {"refused": str(error)})
            raise
        keep_fit(path, {"pos": placed.pos, "qpos": placed.default_qpos})
        return placed
    if "refused" in kept:
        raise ConfigError(kept["refused"])
    return replace(robot, pos=tuple(kept["pos"]), rot=task.robot.rot).with_home(kept["qpos"])


def _found(task: Task, robot: RobotCfg, ways: _Ways) -> RobotCfg:
    """Looks for the place and the posture.

    Raises:
        ConfigError: There is none.
    """
    own = task.robot
    moves = sorted(itertools.product(*BASE_MOVES_M), key=lambda move: float(np.linalg.norm(move)))
    there = replace(robot, pos=own.pos, rot=own.rot)
    ik = BatchedInverseKinematics(there)
    nearest, checked, first = (np.inf, np.inf, np.inf), list[tuple[float, RobotCfg]](), 0
    for together in TOGETHER:
        some = torch.tensor(moves[first : first + together], dtype=torch.float64)
        tries = _tried(ik, ways, some)
        for place, posture in tries.good()[: MOST_CHECKED - len(checked)]:
            move = tuple(tries.moves[place].tolist())
            placed = _placed(there, own, tries.rest[place, posture].numpy(), move)
            touching = _touching(task, placed, ways.starts, tries.ways[:, place, posture])
            if touching <= FREE_SHARE:
                return placed
            checked.append((touching, placed))
        if checked and (len(checked) >= MOST_CHECKED or together > TOGETHER[1]):
            break
        nearest = min(nearest, tries.nearest(), key=lambda each: each[0] + 0.1 * each[1])
        first += together
    if checked:
        return min(checked, key=lambda each: each[0])[1]
    off, turn, speed = nearest
    if off < POSITION_TOLERANCE_M and turn < TURN_TOLERANCE_RAD:
        lacking = f"a joint would have to turn at {speed:.1f} rad/s"
    else:
        miss = f"{1000 * off:.0f} mm and {np.degrees(turn):.0f} degrees"
        lacking = f"its hand misses a pose of the way by {miss}"
    raise ConfigError(
        f"The robot '{robot.name}' cannot do {task.name}: {lacking}, wherever its base stands within "
        f"{_bounds()} of {own.name}'s. Take another one: roboverse list robots"
    )


def _touching(task: Task, robot: RobotCfg, starts: State, ways: Tensor) -> float:
    """Returns the share of postures (T', E, K) on the ways in which the arm touches something."""
    contacts = ArmContacts(task.scenario, robot)
    rest, total = np.array(robot.default_qpos), 0
    for episode in range(TOUCH_EPISODES):
        postures = np.tile(rest, (len(ways), 1))
        postures[:, list(robot.arm)] = ways[:, episode].numpy()
        total += contacts.count(starts, episode, list(postures))
    return total / (TOUCH_EPISODES * len(ways))


def _bounds() -> str:
    return " × ".join(f"{100 * min(moves):.0f} to {100 * max(moves):.0f} cm" for moves in BASE_MOVES_M)


def _placed(robot: RobotCfg, own: RobotCfg, arm: np.ndarray, move: tuple[float, ...]) -> RobotCfg:
    """Returns the robot with base and rest posture, which are rounded, to be alike on all machines."""
    pos = tuple(round(a + float(b), 6) + 0.0 for a, b in zip(own.pos, move, strict=True))
    qpos = np.array(robot.default_qpos)
    qpos[list(robot.arm)] = np.round(arm, 6) + 0.0  # no -0.0
    own_open = np.array([own.joints[index].default for index in own.fingers])
    shut, wide = np.array(own.finger_limits).T
    share = float(np.mean((own_open - shut) / (wide - shut)))
    half_gap = (share * (own.opening_m - own.gripper_closed_m) + own.gripper_closed_m) / 2
    qpos[list(robot.fingers)] = robot.finger_positions(half_gap)
    return replace(robot, pos=(pos[0], pos[1], pos[2])).with_home([float(value) for value in qpos])


def _ways(task: Task) -> _Ways:
    """Returns the pose of the task's own hand at rest, and the ways of its expert."""
    own = task.robot
    ik = BatchedInverseKinematics(own)
    rest = ik.chain(ik.rest[None])
    rngs = [np.random.default_rng(episode) for episode in range(NUM_EPISODES)]
    state = task.initial_state(rngs)
    robot = state.robots[own.name]
    hand = ik.chain(robot.joint_pos[:, ik.chain.columns])
    robot.ee_pos, robot.ee_rot = hand.pos, torch.from_numpy(from_matrix(hand.rot.numpy()))
    robot.joint_target = robot.joint_pos[:, list(own.driven)]
    for item in task.scenario.objects:  # before the first step nothing is felt
        if item.feels:
            state.objects[item.name].touched = torch.zeros(NUM_EPISODES, len(item.feels))
    down = from_matrix(ik.upright.numpy())
    paths = [_path(task, state, row, rngs[row], down) for row in range(NUM_EPISODES)]
    longest = max(len(pos) for pos, _ in paths)

    def stacked(rows: list[np.ndarray]) -> Tensor:
        return torch.as_tensor(
            np.stack([row[np.minimum(np.arange(longest), len(row) - 1)] for row in rows])
        ).double()

    pos, rot = (stacked([path[part] for path in paths]) for part in (0, 1))
    return _Ways(state, (rest.pos[0], rest.rot[0]), pos, rot)


def _path(
    task: Task, state: State, row: int, rng: np.random.Generator, down: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the way (T, 3) and (T, 3, 3) of an episode, which begins where the hand is."""
    one = state.select(torch.tensor([row]))
    hand = one.robots[task.robot.name]
    assert hand.ee_pos is not None and hand.ee_rot is not None
    pos, rot = hand.ee_pos[0].numpy(), hand.ee_rot[0].numpy()
    way = task.foreseen(one, rng)
    if not way:
        return pos[None], to_matrix(rot)[None]
    yaw, pitch, roll = to_euler(multiply(rot, conjugate(down)))
    first = Waypoint(pos=pos, yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0)
    path = interpolate(first, way, WAY_HZ)
    return path.pos, to_matrix(multiply(from_euler(path.turn), down))


@torch.inference_mode()
def _tried(ik: BatchedInverseKinematics, ways: _Ways, moves: Tensor) -> _Tries:
    """Tries places of the base, which is moved by ``moves`` (C, 3)."""
    rest, off, turn = _rest_postures(ik, ways.rest, moves)  # (C, P, K)
    count, postures, joints = rest.shape
    if not ((off < POSITION_TOLERANCE_M) & (turn < TURN_TOLERANCE_RAD)).any():  # no way needs following
        return _Tries(moves, rest, off, turn, torch.zeros_like(off), rest.new_zeros(0))
    episodes, steps = ways.pos.shape[:2]
    q = rest[:, :, None].expand(count, postures, episodes, joints).reshape(-1, joints).clone()
    own_rest = ik.rest
    shift = moves[:, None, None].expand(count, postures, episodes, 3).reshape(-1, 3)
    missed, turned, fastest = (torch.zeros(len(q), dtype=q.dtype) for _ in range(3))
    repeat, kept = count * postures, list[Tensor]()
    ik.rest = q.clone()
    try:
        for step in range(steps):
            pos = ways.pos[:, step].repeat(repeat, 1) - shift
            rot = ways.rot[:, step].repeat(repeat, 1, 1)
            before = q
            for _ in range(WAY_ITERATIONS):
                q = q + ik.change(q, ik.chain(q), pos, rot)
            now = ik.chain(q)
            missed = torch.maximum(missed, (now.pos - pos).norm(dim=-1))
            turned = torch.maximum(turned, rotation_vector(rot @ now.rot.transpose(1, 2)).norm(dim=-1))
            fastest = torch.maximum(fastest, WAY_HZ * (q - before).abs().amax(-1))
            if step % TOUCH_EVERY == 0:
                kept.append(q.reshape(count, postures, episodes, joints))
    finally:
        ik.rest = own_rest

    def worst(values: Tensor) -> Tensor:
        return values.reshape(count, postures, episodes).amax(-1)

    off, turn = torch.maximum(worst(missed), off), torch.maximum(worst(turned), turn)
    return _Tries(moves, rest, off, turn, worst(fastest), torch.stack(kept))


def _rest_postures(
    ik: BatchedInverseKinematics, start: tuple[Tensor, Tensor], moves: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns postures (C, P, K) whose hand is at the start, nearest to the robot's own rest first.

    Beside them what each misses, m and rad, (C, P).
    """
    generator = torch.Generator().manual_seed(0)
    joints, count = len(ik.rest), len(moves)
    offsets = torch.randn((NUM_SEEDS, joints), generator=generator, dtype=torch.float64)
    offsets[0] = 0.0
    q = (ik.rest + offsets).clamp(ik.chain.low, ik.chain.high).repeat(count, 1)
    pos = (start[0] - moves).repeat_interleave(NUM_SEEDS, 0)
    rot = start[1].expand(len(q), 3, 3)
    for _ in range(REST_ITERATIONS):
        q = q + ik.change(q, ik.chain(q), pos, rot)
    now = ik.chain(q)
    off = (now.pos - pos).norm(dim=-1)
    turn = rotation_vector(rot @ now.rot.transpose(1, 2)).norm(dim=-1)
    lost = (off > POSITION_TOLERANCE_M) | (turn > TURN_TOLERANCE_RAD)
    away = (q - ik.rest).norm(dim=-1) + 100.0 * lost + 10.0 * off
    q, off, turn, away = (
        values.reshape(count, NUM_SEEDS, *values.shape[1:]) for values in (q, off, turn, away)
    )
    chosen = torch.stack([_distinct(q[place], away[place]) for place in range(count)])
    rows = torch.arange(count)[:, None]
    return q[rows, chosen], off[rows, chosen], turn[rows, chosen]


def _distinct(q: Tensor, away: Tensor) -> Tensor:
    """Returns the indices (P,) of the best postures (S, K) that differ; if they are few, the best again."""
    chosen: list[int] = []
    for index in away.argsort().tolist():
        if all(float((q[index] - q[other]).abs().max()) > 0.2 for other in chosen):
            chosen.append(index)
        if len(chosen) == NUM_POSTURES:
            break
    chosen += [chosen[0]] * (NUM_POSTURES - len(chosen))
    return torch.tensor(chosen)
