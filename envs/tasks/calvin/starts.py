"""Starts of CALVIN's tasks: symbolic states in which a task can be done, and the poses that they stand for.

In scene D places, door, drawer and switch are those of the authors' evaluation
(``get_env_state_for_initial_condition``); in the others blocks lie anywhere on the scene's own surfaces.
States that only follow from other tasks, such as a block in the hand, are made here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from envs.kinematics.forward import KinematicChain
from envs.rotations import from_matrix, from_yaw, rotate
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.calvin import memory
from envs.tasks.calvin.catalogue import BLOCKS
from envs.tasks.calvin.memory import BLOCK_BITS, PART_BITS, ROBOT_BIT
from envs.tasks.calvin.scene import DESK_M, HALF_WIDTH_M, SURFACES, TABLE
from envs.tasks.calvin.sequences import start_seed, start_symbols, steps_of
from envs.tasks.calvin_table import DRAWER_TRAVEL_M, LAYOUTS, SCALE, SWITCH_TRAVEL_M

LYING_Z_M = DESK_M + HALF_WIDTH_M

CABINET_Y_M = 0.0924044687
CABINET_X_M = {"slider_left": -0.240851662, "slider_right": 0.0703416330}
TABLE_PLACES_M = ((0.0500000896, -0.120000177), (0.229995412, -0.119995140))
"""Of scene D, m (``get_env_state_for_initial_condition``)."""

YAW_RAD = (np.pi / 2 - np.pi / 8, np.pi / 2 + np.pi / 8)
"""Range of a block's turn about z."""

DRAWER_FLOOR_M = 0.34
DRAWER_Y_M = -0.28
"""Floor, and the middle of an open drawer, m."""

_ON_TABLE = ("table", "stacked_bottom")

GAP_M = 0.1
"""Least distance of two blocks on a table, m."""


@dataclass(slots=True)
class _Drawn:
    """One start: joints of the table, and pose and contacts of each block."""

    joints: np.ndarray
    led: bool
    places: dict[str, np.ndarray]
    yaws: dict[str, float]
    touches: dict[str, int]
    held: str | None = None


def drawn_symbols(task: str, rng: np.random.Generator) -> dict[str, int | str]:
    """Draws a symbolic state in which a task can be done: one of the protocol's, changed where it must be."""
    starts, steps = _starts(), steps_of(task)
    while True:
        symbols = dict(starts[int(rng.integers(len(starts)))])
        condition, _ = steps[int(rng.integers(len(steps)))]
        for key, value in condition.items():
            if isinstance(value, tuple):
                symbols[key] = value[int(rng.integers(len(value)))]
            else:
                symbols[key] = value
        if _is_possible(symbols):
            return symbols


@lru_cache(maxsize=1)
def _starts() -> list[dict[str, int | str]]:
    return start_symbols()


def _is_possible(symbols: dict[str, int | str]) -> bool:
    places = [symbols[f"{colour}_block"] for colour in BLOCKS]
    on_table = places.count("table") + places.count("stacked_bottom")
    return on_table <= 2 and max(places.count(f"slider_{side}") for side in ("left", "right")) < 2


def initial_state(
    scene: str,
    scenario: ScenarioCfg,
    symbols: Sequence[dict[str, int | str]],
    rngs: Sequence[np.random.Generator | np.random.RandomState],
    qpos: np.ndarray,
) -> State:
    """Returns the states (N rows) that symbolic states stand for.

    Args:
        scene: ``A`` to ``D``.
        scenario: Its scenario.
        symbols: N symbolic states.
        rngs: Their generators, of places and turns of blocks.
        qpos: Joints of the robot, (N, J).
    """
    robot = scenario.robots[0]
    drawn = [_drawn(scene, row, rng) for row, rng in zip(symbols, rngs, strict=True)]
    qpos = qpos.copy()
    fingers = list(robot.fingers)
    targets = qpos.copy()
    for row, start in enumerate(drawn):
        if start.held is not None:
            qpos[row, fingers], targets[row, fingers] = HALF_WIDTH_M, 0.0
    hand_pos, hand_rot = _hands(robot, qpos)
    blocks = {}
    for colour in BLOCKS:
        pos = np.stack([start.places[colour] for start in drawn])
        rot = from_yaw(np.array([start.yaws[colour] for start in drawn]))
        for row, start in enumerate(drawn):
            if start.held == colour:  # its width between the fingers, which open along the hand's x axis
                pos[row] = hand_pos[row]
                rot[row] = _along_y(hand_rot[row])
        blocks[colour] = (pos, rot)
    return put_together(
        robot,
        qpos,
        targets[:, list(robot.driven)],
        np.stack([start.joints for start in drawn]),
        blocks,
        {colour: np.array([start.touches[colour] for start in drawn]) for colour in BLOCKS},
        np.array([start.led for start in drawn]),
    )


def put_together(
    robot: RobotCfg,
    qpos: np.ndarray,
    targets: np.ndarray,
    joints: np.ndarray,
    blocks: dict[str, tuple[np.ndarray, np.ndarray]],
    touches: dict[str, np.ndarray],
    led: np.ndarray,
) -> State:
    """Returns starts of episodes (N rows), in which nothing moves.

    Args:
        robot: The robot, at its place.
        qpos: Its joints, rad and m, (N, J).
        targets: Targets of its driven joints, (N, D).
        joints: Joints of the table, m, (N, 4).
        blocks: Colour to position, m, (N, 3), and orientation, (N, 4).
        touches: Colour to what touches it, as :func:`envs.tasks.calvin.memory.touches` says, (N,).
        led: Whether the LED is lit, (N,) bool.
    """
    still = np.tile((1.0, 0.0, 0.0, 0.0), (len(qpos), 1))
    arm = EntityState.at_rest(np.array(robot.pos), np.tile(robot.rot, (len(qpos), 1)), qpos)
    arm.joint_target = torch.from_numpy(targets)
    table = EntityState.at_rest(np.zeros(3), still, joints)
    entities = {colour: EntityState.at_rest(pos, rot) for colour, (pos, rot) in blocks.items()}
    touched = {colour: torch.from_numpy(codes) for colour, codes in touches.items()}
    lit = torch.from_numpy(led)
    markers = memory.marks(table.joint_pos, entities, touched, lit, lit)
    objects = {TABLE: table} | {f"block_{colour}": entity for colour, entity in entities.items()}
    objects |= {name: EntityState.at_rest(pos.numpy(), rot.numpy()) for name, (pos, rot) in markers.items()}
    return State({robot.name: arm}, objects)


def _drawn(
    scene: str, symbols: dict[str, int | str], rng: np.random.Generator | np.random.RandomState
) -> _Drawn:
    layout = LAYOUTS[scene]
    joints = np.zeros(4)
    joints[0] = layout.travel * SCALE if symbols["slider"] == "left" else 0.0
    joints[1] = 0.22 if symbols["drawer"] == "open" else 0.0
    joints[3] = SWITCH_TRAVEL_M if symbols["lightbulb"] else 0.0
    assert joints[1] <= DRAWER_TRAVEL_M
    table = _table_places(scene, rng)
    start = _Drawn(joints, bool(symbols["led"]), {}, {}, {})
    for colour in BLOCKS:
        place = symbols[f"{colour}_block"]
        start.yaws[colour] = float(rng.uniform(*YAW_RAD))
        start.touches[colour] = PART_BITS["base"]
        if place in _ON_TABLE:
            second = colour == "pink" or (colour == "blue" and symbols["red_block"] in _ON_TABLE)
            start.places[colour] = np.array([*table[int(second)], LYING_Z_M])
        elif place == "grasped":
            start.places[colour], start.touches[colour], start.held = np.zeros(3), ROBOT_BIT, colour
        elif place == "drawer":
            x = layout.drawer * SCALE + rng.uniform(-0.05, 0.05)
            start.places[colour] = np.array([x, DRAWER_Y_M, DRAWER_FLOOR_M + HALF_WIDTH_M])
            start.touches[colour] = PART_BITS["drawer"]
        elif place != "stacked_top":
            start.places[colour] = np.array([*_cabinet_place(scene, str(place), rng), LYING_Z_M])
            start.touches[colour] = PART_BITS["plank"]
    _stack(symbols, start)
    return start


def _stack(symbols: dict[str, int | str], start: _Drawn) -> None:
    """Puts the top block on the bottom one."""
    where = {symbols[f"{colour}_block"]: colour for colour in BLOCKS}
    if "stacked_top" not in where:
        return
    top, bottom = where["stacked_top"], where["stacked_bottom"]
    start.places[top] = start.places[bottom] + np.array([0.0, 0.0, 2 * HALF_WIDTH_M])
    start.yaws[top] = start.yaws[bottom]
    start.touches[top] = BLOCK_BITS[bottom]
    start.touches[bottom] |= BLOCK_BITS[top]


def _table_places(scene: str, rng: np.random.Generator | np.random.RandomState) -> list[np.ndarray]:
    """Returns two places on the desk, (2,) each."""
    if scene == "D":
        places = [np.array(place) for place in TABLE_PLACES_M]
        rng.shuffle(places)  # pyright: ignore[reportArgumentType]
        return places
    surface = SURFACES[scene]["table"]
    low, high = zip(surface.x, surface.y, strict=True)
    while True:  # a quarter of all draws are too near each other
        places = [rng.uniform(low, high) for _ in range(2)]
        if np.linalg.norm(places[0] - places[1]) > GAP_M:
            return places


def _cabinet_place(
    scene: str, place: str, rng: np.random.Generator | np.random.RandomState
) -> tuple[float, float]:
    if scene == "D":
        return CABINET_X_M[place], CABINET_Y_M
    surface = SURFACES[scene][place]
    middle = sum(surface.x) / 2
    return middle + float(rng.uniform(-0.02, 0.02)), CABINET_Y_M


def protocol_state(scenario: ScenarioCfg, symbols: Sequence[dict[str, int | str]]) -> State:
    """Returns the states (N rows) of scene D in which the authors' evaluation begins, to the digit.

    Args:
        scenario: The scene.
        symbols: N of :func:`~envs.tasks.calvin.sequences.start_symbols`.
    """
    rngs = [np.random.RandomState(start_seed(row)) for row in symbols]
    qpos = np.tile(np.array(scenario.robots[0].default_qpos), (len(rngs), 1))
    return initial_state("D", scenario, symbols, rngs, qpos)


@lru_cache(maxsize=8)
def _chain(robot: RobotCfg) -> KinematicChain:
    return KinematicChain(robot)


def _hands(robot: RobotCfg, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions (N, 3) and orientations (N, 4) of the end effector in postures (N, J)."""
    chain = _chain(robot)
    poses = chain(torch.from_numpy(qpos)[:, chain.columns])
    return poses.pos.numpy(), np.stack([from_matrix(rot) for rot in poses.rot.numpy()])


def _along_y(hand: np.ndarray) -> np.ndarray:
    """Returns the orientation of a block in a hand (4,): its y axis is that along which fingers open."""
    x, _, z = (rotate(hand, axis) for axis in np.eye(3))
    return from_matrix(np.column_stack([np.cross(x, -z), x, -z]))
