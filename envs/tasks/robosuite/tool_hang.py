"""ToolHang, after robosuite 1.5.1 (``environments/manipulation/tool_hang.py``, MIT).

A hook frame goes into a stand, and a wrench is hung on its hook by a ring. Sizes, masses, starts and the rule
are robosuite's. It asks whether bar and ring touch; here they do where each touches the other's thing. Its
reward is 1 for success alone, ours counts how far the task has come.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, norm
from envs.kinematics.waypoints import Waypoint
from envs.rotations import from_matrix, uprightness
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import Start
from envs.tasks.robosuite import hanging
from envs.tasks.robosuite import hook_stand as parts
from envs.tasks.robosuite.scene import RobosuiteTask, pedestal
from envs.tasks.tabletop import FRONT_CAMERA, direction_of, distance, ee_pos, is_held, nearness, point_on

STAND_M = (-0.08, 0.0)
FRAME_M, TOOL_M = (-0.04, -0.24), (0.04, -0.2)
"""Middles of the places, in x and y."""

FRAME_RAD, TOOL_RAD = -2 * np.pi / 3, -np.pi / 2 - np.pi / 9
"""Middles of the headings of the lying rod's upper end, and of the wrench."""

CAMERA_AZIMUTH_RAD = math.radians(-60.0)
"""Azimuth of the cameras, from +x: from the front, the hanging wrench is seen end-on."""

GRASP_REACH_M = 0.03
LINED_UP_M = parts.SOCKET_TOP_M - parts.SOCKET_FLOOR_M + hanging.OVER_M
"""Height of the tip above the socket's floor where the frame is lined up."""


@dataclass(frozen=True, kw_only=True)
class ToolHang(RobosuiteTask):
    """Put the hook frame into the stand and hang the wrench on its hook.

    Attributes:
        spawn_half_size_m: Half the side of the squares of the frame's and of the wrench's start.
        yaw_half_rad: Largest turn of either from the middle of its range.
        most_lean_rad: Largest lean of the stand.
        near_m: Largest distance of the frame's tip from the middle of the stand's base.
        along: Range of the ring's place along the bar, from its end, as a share of its length.
    """

    name: ClassVar[str] = "ToolHang"
    instructions: ClassVar[tuple[str, ...]] = (
        "insert the hook into the base, then hang the wrench on the hook",
        "put the frame into the stand and hang the wrench on it",
        "assemble the stand and hang the tool on its hook",
    )
    max_episode_steps: ClassVar[int] = 1000
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA,
        pos=(
            round(FRONT_CAMERA.pos[0] * math.cos(CAMERA_AZIMUTH_RAD), 9),
            round(FRONT_CAMERA.pos[0] * math.sin(CAMERA_AZIMUTH_RAD), 9),
            FRONT_CAMERA.pos[2],
        ),
        look_at=(-0.06, -0.08, 0.15),
        fovy_deg=27.0,
        orbit_yaw_rad=CAMERA_AZIMUTH_RAD,
    )

    spawn_half_size_m: float = 0.02
    yaw_half_rad: float = np.pi / 18
    most_lean_rad: float = np.pi / 18
    near_m: float = 0.05
    along: tuple[float, float] = (0.05, 1.0)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (parts.stand(), parts.frame(), parts.tool(self.robot.name), pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        half, most = self.spawn_half_size_m, self.yaw_half_rad
        places = rng.uniform(-half, half, (2, 2))
        turns = rng.uniform(-most, most, 2)
        frame, tool = np.array(FRAME_M) + places[0], np.array(TOOL_M) + places[1]
        return {
            "stand": Start((*STAND_M, parts.STAND_HALF_M[2])),
            "frame": Start((*frame, parts.GRIP_HALF_M[0]), rot=_lying(FRAME_RAD + turns[0])),
            "tool": Start((*tool, parts.TOOL_GRIP_HALF_M[2]), TOOL_RAD + turns[1]),
        }

    def assembled(self, state: State) -> Array:
        """Returns whether the frame is in the upright stand, (N,)."""
        stand, frame = state.objects["stand"], state.objects["frame"]
        upright = uprightness(stand.rot) > np.cos(self.most_lean_rad)
        near = distance(point_on(frame, parts.TIP), point_on(stand, parts.BASE_POS)) < self.near_m
        mount, rod = point_on(frame, parts.MOUNT), direction_of(frame, (0.0, 0.0, 1.0))
        walls = [point_on(stand, place) - mount for place in parts.WALLS]
        between = _opposite(walls[0], walls[2], rod) & _opposite(walls[1], walls[3], rod)
        return upright & near & between

    def hung(self, state: State) -> Array:
        """Returns whether the wrench hangs on the frame's bar by its ring, and by nothing else, (N,)."""
        frame, tool = state.objects["frame"], state.objects["tool"]
        end, bar = point_on(frame, parts.HOOK_END), direction_of(frame, (1.0, 0.0, 0.0))
        to_ring = point_on(tool, parts.RING_POS) - end
        ahead = (to_ring * bar).sum(-1)
        near = norm(to_ring - ahead[:, None] * bar) < parts.RING.inner_m - parts.THICK_M / 2
        outer, inner = (point_on(tool, place) - end for place in parts.RING_ENDS)
        share = ahead / (parts.CORNER[0] - parts.HOOK_END[0])
        here = near & _opposite(outer, inner, bar) & (share > self.along[0]) & (share < self.along[1])
        if tool.touched is None or frame.touched is None:
            return here
        touches = (tool.touched[:, 1] > 0.5) & (frame.touched[:, 0] > 0.5)
        return here & touches & (tool.touched[:, 0] < 0.5)

    @override
    def success(self, state: State) -> Tensor:
        return self.assembled(state) & self.hung(state)

    def holds_frame(self, state: State) -> Array:
        """Returns whether the hand holds the frame by its grip, (N,)."""
        grip = point_on(state.objects["frame"], hanging.HELD_FRAME)
        return is_held(self.arm(state), grip, GRASP_REACH_M, 2 * parts.GRIP_HALF_M[0], cfg=self.robot)

    def holds_tool(self, state: State) -> Array:
        """Returns whether the hand holds the wrench by its grip, (N,)."""
        place, width = state.objects["tool"].pos, 2 * parts.TOOL_GRIP_HALF_M[1]
        return is_held(self.arm(state), place, GRASP_REACH_M, width, cfg=self.robot)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0.4 for the frame in the stand, and as much for distances of hand and objects."""
        frame, tool, stand = (state.objects[name] for name in ("frame", "tool", "stand"))
        hand, done = ee_pos(self.arm(state)), self.assembled(state)
        socket = point_on(stand, (*parts.SOCKET_M, parts.SOCKET_FLOOR_M))
        first = nearness(distance(hand, point_on(frame, hanging.HELD_FRAME))) + self.holds_frame(state)
        first = first + nearness(distance(point_on(frame, parts.TIP), socket))
        then = nearness(distance(hand, tool.pos)) + self.holds_tool(state)
        ring, prong = point_on(tool, parts.RING_POS), point_on(frame, parts.PRONG)
        then = then + nearness(distance(ring, prong))
        return 0.13 * (first * ~done + (3.0 + then) * done)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of stand, frame and wrench, end effector, and the ways that are left, (N, 36)."""
        stand, frame, tool = (state.objects[name] for name in ("stand", "frame", "tool"))
        hand = ee_pos(self.arm(state))
        socket = point_on(stand, (*parts.SOCKET_M, parts.SOCKET_FLOOR_M))
        ways = (
            point_on(frame, hanging.HELD_FRAME) - hand,
            tool.pos - hand,
            point_on(frame, parts.TIP) - socket,
            point_on(tool, parts.RING_POS) - point_on(frame, parts.PRONG),
        )
        poses = [part for item in (stand, frame, tool) for part in (item.pos, item.rot)]
        return concatenate((*poses, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        if bool(self.holds_frame(state)[0]):
            return hanging.insert_frame(self, state, rng)
        if not bool(self.assembled(state)[0]):
            return hanging.take_frame(self, state, rng)
        if bool(self.holds_tool(state)[0]):
            return hanging.hang_tool(self, state, rng)
        return hanging.take_tool(self, state, rng)

    @override
    def foreseen(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way of the frame into the stand, and the grasp of the wrench."""
        frame = hanging.take_frame(self, state, rng)
        grip = hanging.HELD_FRAME[2] - parts.TIP[2]
        floor = point_on(state.objects["stand"], (*parts.SOCKET_M, parts.SOCKET_FLOOR_M))[0].numpy()
        socket = [
            replace(frame[-1], pos=floor + np.array([0.0, 0.0, grip + high])) for high in (LINED_UP_M, 0.0)
        ]
        return [*frame, *socket, *hanging.take_tool(self, state, rng)]


def _lying(heading_rad: float) -> np.ndarray:
    """Returns the orientation of a frame whose rod lies with its upper end along a heading, wxyz, (4,)."""
    sine, cosine = float(np.sin(heading_rad)), float(np.cos(heading_rad))
    axes = np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]])
    return from_matrix(axes)


def _opposite(one: Array, other: Array, line: Array) -> Array:
    """Returns whether points (N, 3) are on opposite sides of unit vectors through the origin, (N,)."""
    product = (one * line).sum(-1) * (other * line).sum(-1)
    return (one * other).sum(-1) < product
