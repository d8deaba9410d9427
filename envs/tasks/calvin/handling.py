"""Skills with blocks: grasp, lift, turn, carry, and put down in, on and beside things."""

import numpy as np

from envs.kinematics.waypoints import Waypoint
from envs.rotations import from_matrix
from envs.tasks.arm_at_table import posed
from envs.tasks.calvin.look import DRAWER_MOUTH_M, UP, Block, Look, TablePath, clear_of, down, leaning
from envs.tasks.calvin.scene import DESK_M, HALF_WIDTH_M
from envs.tasks.calvin_table import SCALE

CABINET_TILT_RAD = 1.0
"""Lean of a hand that takes a block out of the cabinet: its front leans by 60 degrees."""

CABINET_BACK_M = 0.012
"""How far short of a block's middle such a hand stops: its palm stays in front of the cabinet."""

MOST_CABINET_TURN = 0.12
"""Tangent of the largest turn of such a hand."""

CABINET_PLACE_Y_M = 0.075
"""Where blocks are put into the cabinet with a hand that points down."""

CABINET_LEAN_RAD, CABINET_LEAN_Y_M = 0.8, 0.05
"""Lean of a hand that drops a block beside another one, and where."""

DROP_M = 0.006
"""Height from which a block is dropped, so that the fingers are off when it lies."""

YAWS_RAD = (-1.75, 2.4)
"""Range of the hand's yaw over the table that leaves the wrist room."""

HANDLE_FRONT_M, HANDLE_ROOM_M = -0.07, 0.15
"""y from which the door's handle is over the desk, with the depth of a hand, and half the width there."""

LIFT_M = 0.1

PLACE_MARGINS_M = (0.035, 0.015, 0.0)
"""Room between the circles round blocks that is asked for, the most first."""

PALM_ROOM_M = 0.04
"""Room in y that a hand in the drawer needs before the desk's edge, and before the drawer's front."""

DRAWER_FRONT_M = -0.16
"""Inner side of the front of a shut drawer, y."""


def lift(look: Look, colour: str) -> TablePath:
    """Grasps a block where it lies, and lifts it clear."""
    block = look.blocks[colour]
    if block.pos[2] > DESK_M and (block.pos[1] > 0.03 or _is_below_handle(look, block.pos)):
        return _lift_in_cabinet(look, block)
    return _lift_from_above(look, block, _best_yaw(look, block), LIFT_M)


def _is_below_handle(look: Look, pos: np.ndarray) -> bool:
    """Returns whether the handle of the sliding door keeps a hand that points down from a place."""
    handle = sum(look.door_m()) / 2
    return bool(pos[1] > HANDLE_FRONT_M and abs(pos[0] - handle) < HANDLE_ROOM_M)


def _lift_from_above(look: Look, block: Block, yaw: float, rise_m: float) -> TablePath:
    point = block.pos + np.array([0.0, 0.0, 0.004])
    return TablePath(look).over(point + 0.09 * UP, down(yaw)).grasp(point).to(point + rise_m * UP)


def _lift_in_cabinet(look: Look, block: Block) -> TablePath:
    """Grasps with a hand that leans; it may hardly turn, for the cabinet is not much wider than a hand."""
    axis, _, _ = min(block.level_axes(), key=lambda item: (item[1] > 0.03, abs(item[0][1])))
    axis = axis * np.sign(axis[0])
    most = MOST_CABINET_TURN if look.luck < 0.3 else np.inf
    rot = leaning(CABINET_TILT_RAD, np.array([1.0, float(np.clip(axis[1] / axis[0], -most, most)), 0.0]))
    point = block.pos - CABINET_BACK_M * rot[:, 2]
    before, up = point - 0.12 * rot[:, 2], point + 0.02 * UP
    return TablePath(look).over(before, rot).grasp(point).to(up).to(up - 0.12 * rot[:, 2])


def _yaws(block: Block) -> list[tuple[float, float]]:
    """Returns yaws of a hand that points down across a block, and half the width between its fingers."""
    found = []
    for axis, width, _ in block.level_axes():
        if width > 0.032:
            continue
        yaw = float(np.arctan2(-axis[1], -axis[0]))
        found += [(yaw + turn, width) for turn in (-2 * np.pi, -np.pi, 0.0, np.pi)]
    return [(yaw, width) for yaw, width in found if YAWS_RAD[0] <= yaw <= YAWS_RAD[1]]


def _best_yaw(look: Look, block: Block, turn: float = 0.0) -> float:
    """Returns the yaw of a hand that grasps a block and can turn by ``turn`` with it."""
    now = posed(look.robot, look.hand_pos, from_matrix(look.hand_rot), 0.0, 0.0).yaw
    others = look.others(block.colour)

    def cost(item: tuple[float, float]) -> float:
        yaw, width = item
        after = yaw + turn
        beyond = max(YAWS_RAD[0] - after, 0.0) + max(after - YAWS_RAD[1], 0.0)
        fingers = np.array([np.cos(yaw), np.sin(yaw)]) * 0.05
        near = sum(
            float(np.linalg.norm(block.pos[:2] + side * fingers - other.pos[:2])) < other.radius_m + 0.012
            for side in (-1.0, 1.0)
            for other in others
            if abs(other.pos[2] - block.pos[2]) < 0.03
        )
        deep = 2.0 * abs(np.sin(yaw)) if block.pos[2] < DESK_M else 0.0  # a drawer is wide and not deep
        return 10.0 * beyond + 3.0 * near + deep + abs(yaw) + 0.3 * abs(yaw - now) + 20.0 * (width - 0.02)

    return min(_yaws(block) or [(0.0, 0.02)], key=cost)[0]


def turn_block(look: Look, colour: str, angle: float) -> list[Waypoint]:
    """Turns a block about the vertical, a little above the desk, and drops it."""
    block = look.blocks[colour]
    yaw = _best_yaw(look, block, angle)
    path = _lift_from_above(look, block, yaw, DROP_M)
    path.to(path.pos, down(yaw + angle / 2)).to(path.pos, down(yaw + angle), hold_s=0.1)
    return path.let_go().waypoints


def carry_sideways(look: Look, colour: str, sign: float, rng: np.random.Generator) -> list[Waypoint]:
    """Moves a block along x, just above the desk where nothing is in between, and drops it."""
    block = look.blocks[colour]
    place = _free_place(look, colour, rng, sign)
    if place is None:
        return []
    yaw = _best_yaw(look, block)
    start = block.pos[:2]
    between = [start + share * (place - start) for share in np.linspace(0.0, 1.0, 8)]
    free = all(clear_of(point, look.others(colour), block.radius_m + 0.02) for point in between)
    height = DROP_M if free else 0.1
    path = _lift_from_above(look, block, yaw, height)
    path.to(np.array([*place, path.pos[2]]))
    return (path if free else path.to(path.pos + (DROP_M - height) * UP)).let_go().waypoints


def _free_place(look: Look, colour: str, rng: np.random.Generator, sign: float = 0.0) -> np.ndarray | None:
    """Returns a free place (2,) on the desk: on one side of a block, or, with no sign, anywhere near."""
    for margin in PLACE_MARGINS_M:
        place = _place_with(look, colour, rng, sign, margin)
        if place is not None:
            return place
    return None


def _place_with(
    look: Look, colour: str, rng: np.random.Generator, sign: float, margin: float
) -> np.ndarray | None:
    block = look.blocks[colour]
    button = np.array([look.layout.button, -0.15]) * SCALE
    best, least = None, np.inf
    for x in np.arange(-0.3, 0.37, 0.02):
        moved = (x - block.pos[0]) * sign
        if sign and not 0.12 < moved < 0.45:
            continue
        for y in np.arange(-0.14, -0.03, 0.015):
            place = np.array([x, y])
            if np.linalg.norm(place - button) < 0.05 + block.radius_m:
                continue
            if not clear_of(place, look.others(colour), block.radius_m + margin):
                continue
            if _is_below_handle(look, place):
                continue
            far = abs(moved - 0.14) if sign else float(np.linalg.norm(place - np.array([0.12, -0.1])))
            cost = far + 0.5 * abs(y - (block.pos[1] if sign else -0.1)) + float(rng.uniform(0.0, 0.03))
            if cost < least:
                best, least = place, cost
    return best


def _put(
    look: Look, colour: str, path: TablePath, place: np.ndarray, *, level: bool = False, lean: float = 0.0
) -> list[Waypoint]:
    """Carries a held block so that its middle reaches ``place`` (3,), lying, and lets go of it.

    Args:
        look: The state.
        colour: The block, in the hand at the path's end.
        path: The way so far.
        place: Where the middle of the block comes, m.
        level: The hand's fingers open along the table there.
        lean: How far the block leans back there, with its front down, rad.
    """
    block = look.blocks[colour]
    in_block = _in_hand(look, block, path)
    rot = _lying(block.rot) @ in_block[0]
    if level:
        yaw = float(np.arctan2(-rot[1, 0], -rot[0, 0]))
        cosine, sine = np.cos(-yaw), np.sin(-yaw)
        rot = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ rot
    if lean:
        cosine, sine = np.cos(lean), np.sin(lean)
        rot = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]]) @ rot
    offset = rot @ in_block[0].T @ in_block[1]
    point = place + offset
    return path.over(point + 0.07 * UP, rot).to(point, hold_s=0.1, slow=1.3).let_go().waypoints


def _in_hand(look: Look, block: Block, path: TablePath) -> tuple[np.ndarray, np.ndarray]:
    """Returns the hand in a block's frame: orientation (3, 3), position (3,)."""
    if look.held == block.colour:
        return block.rot.T @ look.hand_rot, block.rot.T @ (look.hand_pos - block.pos)
    return block.rot.T @ path.rot, np.array([0.0, 0.0, 0.004])  # as it will be grasped


def _lying(rot: np.ndarray) -> np.ndarray:
    """Returns the nearest orientation (3, 3) in which the most vertical axis is vertical."""
    standing = int(np.abs(rot[2]).argmax())
    axis = rot[:, standing] * np.sign(rot[2, standing])
    turn = np.cross(axis, UP)
    sine, cosine = float(np.linalg.norm(turn)), float(axis @ UP)
    if sine < 1e-9:
        return rot
    x, y, z = turn / sine
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (np.eye(3) + sine * skew + (1.0 - cosine) * skew @ skew) @ rot


def put_on_desk(look: Look, colour: str, rng: np.random.Generator) -> list[Waypoint]:
    """Puts a held block down at a free place of the desk."""
    place = _free_place(look, colour, rng)
    if place is None:
        return []
    height = DESK_M + HALF_WIDTH_M + DROP_M
    return _put(look, colour, TablePath(look), np.array([*place, height]))


def put_on_block(look: Look, colour: str) -> list[Waypoint]:
    """Puts a held block on another one that lies on the desk with nothing on it."""
    others = look.others(colour)
    able = [
        b
        for b in others
        if abs(b.pos[2] - DESK_M - HALF_WIDTH_M) < 0.01 and b.pos[1] < 0.0 and not _is_covered(b, others)
    ]
    if not able:
        return []
    below = min(able, key=lambda b: float(np.linalg.norm(b.pos - look.hand_pos)))
    place = np.array([*below.pos[:2], below.top_m + HALF_WIDTH_M + 0.004])
    return _put(look, colour, TablePath(look), place)


def _is_covered(block: Block, others: list[Block]) -> bool:
    return any(
        other.pos[2] > block.pos[2] + 0.02 and np.linalg.norm(other.pos[:2] - block.pos[:2]) < 0.05
        for other in others
        if other is not block
    )


def drawer_is_reachable(look: Look, y: float | None = None) -> bool:
    """Returns whether the hand fits into the drawer, at ``y`` or anywhere."""
    front = DRAWER_FRONT_M - float(look.joints[1])
    if y is None:
        return front < DRAWER_MOUTH_M - 2 * PALM_ROOM_M
    return y < DRAWER_MOUTH_M - PALM_ROOM_M + 0.005


def put_in_drawer(
    look: Look, colour: str, rng: np.random.Generator, path: TablePath | None = None
) -> list[Waypoint]:
    """Puts a held block into the open drawer."""
    front = DRAWER_FRONT_M - float(look.joints[1])
    y = max((front + DRAWER_MOUTH_M) / 2, -0.29)
    in_drawer = [b for b in look.others(colour) if b.pos[2] < DESK_M - 0.02]
    middle = look.layout.drawer * SCALE
    spots = middle + np.array([0.0, -0.06, 0.06, -0.04, 0.04])
    room = [min((abs(x - b.pos[0]) for b in in_drawer), default=1.0) for x in spots]
    x = float(spots[int(np.argmax(np.minimum(room, 0.09)))]) + float(rng.uniform(-0.01, 0.01))
    place = np.array([x, y, 0.34 + HALF_WIDTH_M + 0.02])
    return _put(look, colour, path or TablePath(look), place, level=True)


def put_in_cabinet(look: Look, colour: str) -> list[Waypoint]:
    """Puts a held block into the half of the cabinet that the door leaves open.

    Beside a block that lies there is no room for a hand that points down: one that leans drops it there.
    """
    left, right = look.door_m()
    low, high = (SCALE * end for end in look.layout.opening)
    low, high = (low, left) if left - low > high - right else (right, high)
    inside = [
        b.pos[0] for b in look.others(colour) if b.pos[1] > 0.02 and low - 0.03 < b.pos[0] < high + 0.03
    ]
    middle, upright = (low + high) / 2, DESK_M + HALF_WIDTH_M + 0.008
    if all(abs(x - middle) > 0.085 for x in inside):
        place = np.array([middle, CABINET_PLACE_Y_M, upright])
        return _put(look, colour, TablePath(look), place, level=True)
    spots = np.linspace(low + 0.045, high - 0.045, 9)
    x = float(max(spots, key=lambda spot: min(abs(spot - other) for other in inside)))
    place = np.array([x, CABINET_LEAN_Y_M, DESK_M + 0.05])
    return _put(look, colour, TablePath(look), place, level=True, lean=CABINET_LEAN_RAD)
