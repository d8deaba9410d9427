"""ToolUse, after the robosuite task zoo (``tool_use.py``): its widest starts, those of ``ToolUseEnv``.

The zoo's reward is success alone, and it does not ask whether the tool was used; the expert uses it.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate
from envs.kinematics.waypoints import Waypoint, grasp_yaw
from envs.scenario import ObjectCfg
from envs.state import State
from envs.tasks.arm_at_table import Start, heading, point
from envs.tasks.robosuite.scene import pedestal
from envs.tasks.skills.from_above import PUSH_M_S, put, slide, take
from envs.tasks.skills.moves import Hand, at_height
from envs.tasks.tabletop import GRASP_CLOSED_M, GRASP_OPEN_M, ee_pos, flat_distance, point_on
from envs.tasks.task_zoo import parts
from envs.tasks.task_zoo.parts import TABLE_X_M

CUBE_HALF_M = (0.02, 0.025, 0.02)
TOOL_HALF_HEIGHT_M = 0.02
HANDLE_M, HOOK_X_M, HOOK_HALF_M = 0.11, 0.11, 0.006
"""Half the length of the tool's handle, where its hook is, and half the hook's thickness."""

POT_M = (TABLE_X_M + 0.2, 0.18)
NEAR_M, NEAR_Z_M = 0.06, 0.05
"""The cube is in the pot within these distances of its middle, level and upright."""

GRIP_M = -0.02
"""Where the expert grips the handle, from its middle to the hook."""

BEHIND_M, BESIDE_M = 0.01, 0.05
"""Gap between hook and cube, and distance of the cube from the handle, when the tool is set down."""

PULL_M, FREE_M = 0.13, 0.05
"""How far the expert pulls, and how far it then moves the hook off the cube."""

FAR_X_M = 0.04
"""The expert takes the tool where the cube is beyond."""

TRAVEL_M = 0.2


@dataclass(frozen=True, kw_only=True)
class ToolUse(parts.ZooTask):
    """Pull a cube near with an L-shaped tool, and put it into a pot.

    Attributes:
        cube_x_m: Range of the cube along x.
        cube_y_m: Likewise along y.
        tool_x_m: Range of the tool along x.
        tool_y_m: Likewise along y.
    """

    name: ClassVar[str] = "ToolUse"
    instructions: ClassVar[tuple[str, ...]] = (
        "pull the cube near with the L-shaped tool and put it in the pot",
        "use the tool to bring the blue cube closer, then place the cube into the pot",
        "hook the cube with the tool and drop it into the pot",
    )
    max_episode_steps: ClassVar[int] = 500
    has_reward: ClassVar[bool] = False

    cube_x_m: tuple[float, float] = (TABLE_X_M + 0.29, TABLE_X_M + 0.32)
    cube_y_m: tuple[float, float] = (-0.25, -0.10)
    tool_x_m: tuple[float, float] = (TABLE_X_M + 0.06, TABLE_X_M + 0.08)
    tool_y_m: tuple[float, float] = (-0.23, -0.03)

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        handle = (HANDLE_M, 0.011, TOOL_HALF_HEIGHT_M)
        hook = (HOOK_HALF_M, 0.06, TOOL_HALF_HEIGHT_M)
        smooth = (0.005, 0.005, 0.0001)
        tool = ObjectCfg(
            name="tool",
            geoms=(
                parts.box(handle, (0.0, 0.0, 0.0), parts.RED_WOOD, 0.1936, smooth),
                parts.box(hook, (HOOK_X_M, 0.05, 0.0), parts.RED_WOOD, 0.0006, smooth),
            ),
            pos=(0.0, 0.0, TOOL_HALF_HEIGHT_M),
        )
        cube = parts.block("cube", CUBE_HALF_M, (0.15, 0.3, 0.7, 1.0), ("pot",))
        return (parts.pot(), cube, tool, pedestal(self.robot))

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        cube = (rng.uniform(*self.cube_x_m), rng.uniform(*self.cube_y_m), CUBE_HALF_M[2])
        tool = (rng.uniform(*self.tool_x_m), rng.uniform(*self.tool_y_m), TOOL_HALF_HEIGHT_M)
        return {
            "pot": Start((*POT_M, parts.POT_BOTTOM_M)),
            "cube": Start(cube, -np.pi / 2),
            "tool": Start(tool),
        }

    @override
    def success(self, state: State) -> Tensor:
        cube, pot = state.objects["cube"], state.objects["pot"]
        close = flat_distance(cube.pos, pot.pos) < NEAR_M
        inside = close & (abs(cube.pos[:, 2] - pot.pos[:, 2]) < NEAR_Z_M)
        return inside if cube.touched is None else inside & (cube.touched[:, 0] > 0.5)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns 0: the zoo rewards success alone."""
        return 0.0 * state.objects["cube"].pos[:, 0]

    @override
    def observe(self, state: State) -> Array:
        """Returns poses of cube, tool and pot, end effector, and ways between them, (N, 33)."""
        cube, tool, pot = (state.objects[name] for name in ("cube", "tool", "pot"))
        hand = ee_pos(self.arm(state))
        ways = (tool.pos - hand, cube.pos - hand, pot.pos - cube.pos)
        return concatenate((cube.pos, cube.rot, tool.pos, tool.rot, pot.pos, pot.rot, hand, *ways))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        hand, cube = Hand.of(self, state, rng), state.objects["cube"]
        if cube.pos[0, 0] > FAR_X_M:
            return self._pull(state, hand, rng)
        # Fingers close along x: handle and hook of the tool are beside the cube.
        turn = heading(cube) + np.pi / 2 * round((np.pi / 2 - heading(cube)) / (np.pi / 2))
        turn -= np.pi if turn > np.pi / 2 + 0.3 else 0.0
        grip = point(cube) + np.array([0.0, 0.0, 0.004])
        way = take(hand, grip, turn, TRAVEL_M, rng)
        over = at_height(point(state.objects["pot"]), 0.1)
        return [*way, *put(hand.after(way), over, 0.0, TRAVEL_M, rng, opening_m=0.035)]

    def _pull(self, state: State, hand: Hand, rng: np.random.Generator) -> list[Waypoint]:
        """Returns the way that takes the tool, sets its hook behind the cube, pulls, and frees the cube."""
        tool, cube = state.objects["tool"], point(state.objects["cube"])
        grip = point_on(tool, (GRIP_M, 0.0, 0.008))[0].numpy().copy()
        turn = grasp_yaw(heading(tool), np.pi)
        way = take(hand, grip, turn, TRAVEL_M, rng)
        x = cube[0] + CUBE_HALF_M[1] + BEHIND_M + HOOK_HALF_M - HOOK_X_M + GRIP_M
        down = np.array([x, cube[1] - BESIDE_M, grip[2] + 0.001])
        lower = put(hand.after(way), down, 0.0, TRAVEL_M, rng)[:-2]
        near = down - np.array([PULL_M, 0.0, 0.0])
        free, shut, wide = near + np.array([FREE_M, 0.0, 0.0]), GRASP_CLOSED_M, GRASP_OPEN_M
        pulls = slide(lower[-1], (near,), (0.4 + PULL_M / PUSH_M_S,))
        frees = replace(hand, pos=near).to(free, 0.0, shut)
        still = replace(hand, pos=free)
        up = [still.to(free, 0.0, wide, hold_s=0.1), still.to(at_height(free, TRAVEL_M), 0.0, wide)]
        return [*way, *lower, *pulls, frees, *up]
