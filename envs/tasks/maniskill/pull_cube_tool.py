"""PullCubeTool, after ManiSkill 3 (``tabletop/pull_cube_tool.py``).

The stages of the reward and their weights are ManiSkill's; how well the hook is placed is measured in the
tool's frame, so that the tool may turn. A cube that would start inside the tool is drawn again.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, norm, within
from envs.kinematics.waypoints import Waypoint, correction_s, first_miss, miss
from envs.rotations import conjugate, rotate
from envs.scenario import CameraCfg, ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import (
    ArmAtTable,
    Start,
    above,
    heading,
    point,
    tip_to_reach,
    travel_s,
    way,
)
from envs.tasks.maniskill.parts import BLUE, CUBE_HALF_SIZE_M, RED, box, cube
from envs.tasks.skills.from_above import grasp, slide
from envs.tasks.tabletop import (
    FRONT_CAMERA,
    GRASP_CLOSED_M,
    GRASP_OPEN_M,
    distance,
    ee_pos,
    flat_distance,
    is_held,
    nearness,
    point_on,
)

GRIP_M = 0.03
"""Where the handle is gripped: distance from its free end."""

HANDLE_DENSITY_KG_M3 = 500.0
GRASP_REACH_M = 0.03
FAR_M = 1.0
"""Distance of the farthest cube from the base, about."""

HOOK_SLACK_M = 0.015
"""Gap between hook and cube when the expert has set the tool down."""

FINAL_M = 0.03
"""How much nearer than necessary the expert pulls the cube."""

LIFT_M = 0.07


@dataclass(frozen=True, kw_only=True)
class PullCubeTool(ArmAtTable):
    """Take an L-shaped tool, put its hook behind a cube that is far away, and pull the cube near.

    Attributes:
        cube_half_size_m: Half the side of the cube.
        handle_length_m: Length of the tool.
        hook_length_m: Thickness of its hook.
        width_m: Width of its handle; the hook is twice as long.
        height_m: Height of the tool.
        tool_x_m: Range of the handle's free end along x.
        tool_y_m: Likewise along y.
        cube_x_m: Range of the cube along x.
        cube_y_m: Likewise along y.
        cube_yaw_rad: Largest turn of the cube.
        near_m: Level distance of the cube from the robot's base that is a success.
    """

    name: ClassVar[str] = "PullCubeTool"
    instructions: ClassVar[tuple[str, ...]] = (
        "use the L-shaped tool to pull the blue cube towards the robot",
        "pick up the red tool and hook the cube within reach",
        "pull the far cube near with the hook",
    )
    max_episode_steps: ClassVar[int] = 200
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, look_at=(0.0, -0.08, 0.08), fovy_deg=36.0)

    cube_half_size_m: float = CUBE_HALF_SIZE_M
    handle_length_m: float = 0.2
    hook_length_m: float = 0.05
    width_m: float = 0.05
    height_m: float = 0.05
    tool_x_m: tuple[float, float] = (-0.3, -0.1)
    tool_y_m: tuple[float, float] = (-0.3, -0.1)
    cube_x_m: tuple[float, float] = (0.05, 0.25)
    cube_y_m: tuple[float, float] = (-0.25, 0.05)
    cube_yaw_rad: float = np.pi / 6
    near_m: float = 0.6

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        long, hook, wide, high = self.handle_length_m, self.hook_length_m, self.width_m, self.height_m
        # ManiSkill's hook begins in the middle of the handle; here each part has its own share of the volume.
        handle = box((long / 2, wide / 2, high / 2), RED, (long / 2, 0.0, 0.0), HANDLE_DENSITY_KG_M3)
        end = box((hook / 2, wide, high / 2), RED, (long - hook / 2, wide, 0.0))
        tool = ObjectCfg(name="tool", geoms=(handle, end), pos=(-0.2, -0.2, high / 2))
        return (tool, cube("cube", self.cube_half_size_m, BLUE))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        tool = np.array([rng.uniform(*self.tool_x_m), rng.uniform(*self.tool_y_m)])
        while True:
            place = np.array([rng.uniform(*self.cube_x_m), rng.uniform(*self.cube_y_m)])
            if not self._inside(*(place - tool)):
                break
        yaw = rng.uniform(-self.cube_yaw_rad, self.cube_yaw_rad)
        return {
            "tool": Start((*tool, self.height_m / 2)),
            "cube": Start((*place, self.cube_half_size_m), yaw),
        }

    @override
    def success(self, state: State) -> Tensor:
        return self._away(state) < self.near_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's stages: 2 for reach, 2 for grasp, 1.5 for the hook's place, 3 for the pull."""
        tool, robot = state.objects["tool"], self.arm(state)
        grip = point_on(tool, (GRIP_M, 0.0, 0.0))
        held = is_held(robot, grip, GRASP_REACH_M, self.width_m, cfg=self.robot)
        local = self._cube_in_tool(state)
        placed = nearness(norm(local - constant((*self._hooked, 0.0), local)), 3.0)
        aside = abs(local[:, 1] - self._hooked[1]) < self.width_m
        inside = aside & (local[:, 0] < self.handle_length_m) & (local[:, 0] > 0.0)
        pulled = within((FAR_M - self._away(state)) / FAR_M, 0.0, 1.0)
        stages = 2.0 * nearness(distance(ee_pos(robot), grip)) + held * (
            2.0 + 1.5 * placed + 3.0 * pulled * inside
        )
        return stages / 8.6

    @override
    def observe(self, state: State) -> Tensor:
        """Returns poses of tool and cube, the end effector, and ways between them, (N, 23)."""
        tool, item = state.objects["tool"], state.objects["cube"]
        hand = ee_pos(self.arm(state))
        return concatenate(
            (tool.pos, tool.rot, item.pos, item.rot, hand, tool.pos - hand, item.pos - tool.pos)
        )

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        tool, item, grip = state.objects["tool"], point(state.objects["cube"]), GRASP_CLOSED_M
        turn, base = heading(tool), np.array(self.robot.pos)
        start = point(tool) + GRIP_M * np.array([np.cos(turn), np.sin(turn), 0.0])
        start[2] = self.height_m / 2
        from_base = (item - base)[:2]
        far, line = float(np.linalg.norm(from_base)), float(np.arctan2(from_base[1], from_base[0]))
        ahead, left = (
            np.array([np.cos(line), np.sin(line), 0.0]),
            np.array([-np.sin(line), np.cos(line), 0.0]),
        )
        x, y = self._hooked
        hook = np.array([item[0], item[1], start[2]]) - (x - HOOK_SLACK_M - GRIP_M) * ahead - y * left
        tip = tip_to_reach(hook, self.robot)
        noise = first_miss(rng, (0.06, 0.09), seldom_m=0.02)
        aside = rng.normal(0.0, miss(rng, often_m=0.008, seldom_m=0.02), 2)
        over = above(hook, LIFT_M)
        near = over + np.array([*aside, 0.0])
        back = hook - (far - self.near_m + FINAL_M + HOOK_SLACK_M) * ahead
        come = way(over, line, grip, correction_s(aside) + 0.1, 0.1, tip)
        pull_s = 0.3 + 4.0 * float(np.linalg.norm(back - hook))
        places = (above(hook, 0.002), above(back, 0.002))
        return [
            *self.rise(state, 0.12),
            *grasp(way(start + noise, turn, GRASP_OPEN_M, 1.0, pitch=tip), start, rng, 0.02),
            way(above(start, LIFT_M), turn, grip, 0.5, 0.0, tip),
            way(near, line, grip, travel_s(start, near, 0.6), 0.0, tip),
            come,
            *slide(come, places, (0.6, pull_s), settle_s=0.1, hold_s=0.2),
        ]

    @property
    def _hooked(self) -> tuple[float, float]:
        """Place of a cube in the tool's frame that its hook pulls, m."""
        x = self.handle_length_m - self.hook_length_m - 1.3 * self.cube_half_size_m
        return x, self.width_m / 2 + 1.9 * self.cube_half_size_m

    def _inside(self, x: float, y: float) -> bool:
        """Returns whether a cube at a place in the tool's frame would touch it."""
        edge = np.sqrt(2.0) * self.cube_half_size_m
        handle = -edge < x < self.handle_length_m + edge and abs(y) < self.width_m / 2 + edge
        hook = abs(x - self.handle_length_m + self.hook_length_m / 2) < self.hook_length_m / 2 + edge
        return handle or (hook and -edge < y < 2 * self.width_m + edge)

    def _cube_in_tool(self, state: State) -> Array:
        tool = state.objects["tool"]
        return rotate(conjugate(tool.rot), state.objects["cube"].pos - tool.pos)

    def _away(self, state: State) -> Array:
        return flat_distance(state.objects["cube"].pos, self.arm(state).pos)
