"""The expert's ways of ToolHang: the frame into the stand, and the wrench onto the frame's hook.

Both things are moved by their own poses: each part of a way moves the hand's targets by what still lacks.
"""

from dataclasses import replace

import numpy as np

from envs.kinematics.waypoints import Waypoint, first_miss
from envs.rotations import conjugate, from_matrix, rotate, wrapped
from envs.state import EntityState, State
from envs.tasks.arm_at_table import ArmAtTable, above, heading, point, travel_s
from envs.tasks.arms import in_world
from envs.tasks.robosuite import hook_stand as parts
from envs.tasks.robosuite.scene import UPRIGHT_PITCH_RAD, down
from envs.tasks.skills.from_above import grasp
from envs.tasks.skills.held import Held, Pose
from envs.tasks.skills.insertion import FAR_M, UP, Insertion, insertion_way
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M, ee_pos, hand_yaw

LEVEL_PITCH_RAD = UPRIGHT_PITCH_RAD - np.pi / 2
"""Pitch, in a waypoint, of a hand whose fingers point ahead."""

HELD_FRAME: tuple[float, float, float] = (parts.ROD_X_M, 0.0, parts.GRIP_POS[2] - 0.006)
"""Where the frame is held: clear of the bar, on its grip."""

TURNING_M, INSERT_YAW_RAD = np.array([-0.1, -0.12, 0.42]), np.pi / 2
"""Where the hand turns the frame upright, and its turn then: the bar points at the robot."""

OVER_M, EXACT_M, EXACT_RAD = 0.02, 0.0012, 0.02
"""Height of the tip over the socket where it is lined up, and what may lack then."""

ABOVE_HOOK_M, RING_EXACT_M = 0.05, 0.002
"""Height over the bar at which the ring is lined up, and the error at which it is lowered."""

TILT_RAD, LEAN_RAD = 0.7, 0.7
"""Tilt at which the wrench is let go of, so that it swings down, and lean of the hand that grasps it: so near
its base the robot cannot lean it back far."""

HOLE_M = parts.RING.radius_m - parts.RING.block_m
"""Distance of the inner faces of the ring's blocks from its middle."""

FREE_M = 0.001
"""Distance of the ring's inner block from bar and prong when the wrench is tilted."""


def _take(
    task: ArmAtTable,
    state: State,
    grip: np.ndarray,
    yaw: float,
    rise_m: float,
    rng: np.random.Generator,
    lean: float = 0.0,
) -> list[Waypoint]:
    """Returns the way to grasp something that lies, from above, and to lift it; the approach first misses."""
    robot = task.arm(state)
    hand, turn = ee_pos(robot)[0].numpy().copy(), hand_yaw(robot)
    noise = first_miss(rng, (0.05, 0.07), often_m=0.008, seldom_m=0.02)
    turn_s = travel_s(hand, grip, 0.6) + 0.3 * abs(yaw - turn)
    ways = []
    if hand[2] < 0.2:
        leave = down(np.array([hand[0], hand[1], 0.25]), turn, GRASP_OPEN_M, 0.7)
        ways.append(replace(leave, pitch=task.commanded(state).pitch))
    return [
        *ways,
        *grasp(down(grip + noise, yaw, GRASP_OPEN_M, turn_s, tip=lean), grip, rng, 0.02, hold_s=0.1),
        down(above(grip, rise_m), yaw, GRASP_CLOSED_M, 1.0, hold_s=0.1, tip=lean),
    ]


def take_frame(task: ArmAtTable, state: State, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the way to grasp the lying frame, and to turn it upright."""
    frame = state.objects["frame"]
    up = rotate(frame.rot[0].numpy(), np.array([0.0, 0.0, 1.0]))
    yaw = float(np.arctan2(up[1], up[0]))
    ways = _take(task, state, in_world(frame, HELD_FRAME), yaw, 0.25, rng)
    turning = TURNING_M + rng.uniform(-0.01, 0.01, 3)
    turned = down(turning, INSERT_YAW_RAD, GRASP_CLOSED_M, 0.5 + 0.6 * abs(INSERT_YAW_RAD - yaw))
    return [*ways, turned, replace(turned, pitch=LEVEL_PITCH_RAD, duration_s=2.0, hold_s=0.2)]


def insert_frame(task: ArmAtTable, state: State, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the next part of the way of the held frame: over the socket, a correction, down, or let go."""
    frame, stand = state.objects["frame"], state.objects["stand"]
    held, floor = Held.of(task, state, "frame"), (*parts.SOCKET_M, parts.SOCKET_FLOOR_M)
    tip = Pose(in_world(frame, parts.TIP), held.pose.rot)
    off = rotate(conjugate(stand.rot[0].numpy()), tip.pos - in_world(stand, floor))
    if off[2] < 0.008 and np.linalg.norm(off[:2]) < 0.006:
        now = replace(held.now, gripper=GRASP_OPEN_M)
        back = now.pos - 0.12 * np.array([np.cos(now.yaw), np.sin(now.yaw), 0.0])
        return [
            replace(now, duration_s=0.3, hold_s=0.2),
            replace(now, pos=back, duration_s=0.8),
            replace(now, pos=above(back, 0.12), duration_s=0.8),
        ]
    turn, base = heading(frame), heading(stand)
    fitting = base + np.pi / 2 * round((turn - base) / (np.pi / 2))
    where = Insertion(
        goal=Pose.level(in_world(stand, above(np.array(floor), 0.002)), fitting),
        into=-rotate(stand.rot[0].numpy(), UP),
        back_m=parts.SOCKET_TOP_M - parts.SOCKET_FLOOR_M + OVER_M - 0.002,
        exact_m=EXACT_M,
        exact_rad=EXACT_RAD,
        speed_m_s=0.08,
        step_m=0.06,
    )
    return insertion_way(replace(held, pose=tip), where, rng)


def take_tool(task: ArmAtTable, state: State, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the way to grasp the lying wrench, and to lift it."""
    tool = state.objects["tool"]
    flip = _flip(state.objects["frame"])
    yaw, lean = float(wrapped(heading(tool) + flip)), LEAN_RAD if flip else -LEAN_RAD
    return _take(task, state, above(point(tool), 0.004), yaw, 0.3, rng, lean)


def _flip(frame: EntityState) -> float:
    """Returns the turn of the hand to the wrench, 0 or π: over the hook the hand is turned least."""
    return np.pi if abs(wrapped(heading(frame) + np.pi)) > np.pi / 2 else 0.0


def hang_tool(task: ArmAtTable, state: State, rng: np.random.Generator) -> list[Waypoint]:
    """Returns the next part of the way of the held wrench: its ring over the prong, or down and let go."""
    tool, frame, held = state.objects["tool"], state.objects["frame"], Held.of(task, state, "tool")
    outward = rotate(frame.rot[0].numpy(), np.array([-1.0, 0.0, 0.0]))
    ahead = np.array([outward[0], outward[1], 0.0]) / np.linalg.norm(outward[:2])
    foot = in_world(frame, parts.PRONG)
    ring = in_world(tool, parts.RING_POS)
    side = 1.0 if rotate(tool.rot[0].numpy(), np.array([0.0, 0.0, 1.0]))[2] > 0 else -1.0

    def at(up_m: float, duration_s: float, hold_s: float = 0.0, tilt: float = 0.0) -> Waypoint:
        """The wrench outward of the bar, tilted down, its ring round the prong so far above the bar."""
        up = np.array([0.0, 0.0, 1.0])
        x, across = np.cos(tilt) * ahead - np.sin(tilt) * up, np.cos(tilt) * up + np.sin(tilt) * ahead
        rot = from_matrix(np.stack([x, np.cross(side * across, x), side * across], axis=1))
        # The inner block stays on the bar and inward of the prong, which its upper edge comes nearer to.
        edge = -parts.THICK_M / 2 - FREE_M - 2 * parts.RING_HALF_M * np.sin(tilt)
        place = foot + edge * ahead + (FREE_M + up_m) * up
        place = place + HOLE_M * x + parts.RING_HALF_M * across
        goal = Pose(place - rotate(rot, np.array(parts.RING_POS)), rot)
        return held.to(goal, duration_s, hold_s)

    spin = float(wrapped(np.arctan2(ahead[1], ahead[0]) - heading(tool)))
    middle = foot + (HOLE_M - parts.THICK_M / 2 - FREE_M) * ahead
    off = float(np.linalg.norm((ring - middle)[:2]))
    if off > FAR_M or abs(spin) > 0.3:
        # The way first misses: the next motion demonstrates the correction.
        aside = first_miss(rng, often_m=0.004, seldom_m=0.01)
        far = at(ABOVE_HOOK_M + 0.02, 1.5 + 0.7 * abs(spin), 0.2)
        return [replace(far, pos=far.pos + aside)]
    if off > RING_EXACT_M or abs(spin) > 0.05:
        return [at(ABOVE_HOOK_M, 0.5, 0.25)]
    *tilting, tilted = (at(0.0, 0.3, 0.0, share * TILT_RAD) for share in (0.2, 0.4, 0.6, 0.8, 1.0))
    let_go = replace(tilted, gripper=GRASP_OPEN_M, duration_s=0.2, hold_s=0.2)
    tip = tilted.pitch - UPRIGHT_PITCH_RAD
    back = np.array([np.cos(tilted.yaw) * np.sin(tip), np.sin(tilted.yaw) * np.sin(tip), np.cos(tip)])
    away = replace(let_go, pos=let_go.pos + 0.1 * back, duration_s=0.8, hold_s=0.5)
    return [at(0.0, 1.0, 0.1), *tilting, replace(tilted, hold_s=0.2), let_go, away]
