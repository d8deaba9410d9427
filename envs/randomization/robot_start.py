"""The channel ``robot``: the posture in which the arm starts.

Every joint of the arm is offset from where the task has it. The offsets of the first two joints, which move
the hand most, are drawn from the cells of a grid, and every tenth cell is held out for the test split: a
posture of a test episode occurs in no training episode.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, override

import numpy as np

from envs.core.errors import ConfigError
from envs.randomization.channels import Channel, Scene, Workspace, divided

if TYPE_CHECKING:
    from envs.randomization.splits import Split
    from envs.scenario import RobotCfg, ScenarioCfg
    from envs.state import State

BOUND_RAD = 0.2
"""Largest offset of an arm's joint, rad (m for one that slides).

It moves a Panda's hand, 0.6 m from its base, by up to 12 cm with one joint: beyond the 1 cm of the tasks' own
noise (0.02 rad), and within the 0.2 m in which the objects of a tabletop task lie, so the camera sees the
hand.
"""

CELLS = (11, 10)
"""Cells of the grid, along the offset of the first and of the second joint of the arm."""

CLEARANCE_M = 0.12
"""Least height of the hand above the table: no object that stands there as a distractor is higher."""

CANDIDATES = 32
"""Postures that are drawn; the first that is free is taken, and the task's own where none is."""


def cells(split: str, num_joints: int = 2) -> tuple[tuple[int, ...], ...]:
    """Returns the cells of the grid that a split may draw, for an arm of so many joints.

    Held out are one cell of each row, three columns on from that of the row before: all over the grid, and
    not the middle, where the task's own starts are.
    """
    rows, columns = CELLS
    if num_joints == 1:
        return divided([(row,) for row in range(rows)], split)
    return divided([(i, (3 * (i + 1) + j) % columns) for i in range(rows) for j in range(columns)], split)


@dataclass(frozen=True, slots=True)
class RobotDraw:
    """One sample of the channel.

    Attributes:
        offsets_rad: Offsets of the arm's joints, rad (m), of each candidate.
    """

    offsets_rad: tuple[tuple[float, ...], ...]


class RobotChannel(Channel):
    """Offsets the arm's joints at the start, where it touches nothing and the hand is above the table."""

    @override
    def split(self, scene: Scene) -> tuple[tuple[int, ...], ...]:
        return cells(scene.split.name, len(_robot_of(scene).arm))

    @override
    def sample(
        self, rng: np.random.Generator, allowed: tuple[tuple[int, ...], ...], scene: Scene
    ) -> RobotDraw:
        count = len(_robot_of(scene).arm)
        return RobotDraw(tuple(_offsets(rng, allowed, count) for _ in range(CANDIDATES)))

    @override
    def start(self, state: "State", draw: RobotDraw, scene: Scene) -> "State":
        workspace = scene.workspace
        assert workspace is not None, "whoever starts episodes gives the workspace"
        robot = workspace.robot
        arm = state.robots[robot.name]
        qpos = _free_posture(workspace, state, arm.joint_pos[0].numpy(), draw.offsets_rad)
        moved = replace(arm, joint_pos=arm.joint_pos.new_tensor(qpos)[None], joint_target=None)
        return replace(state, robots={**state.robots, robot.name: moved})

    @override
    def scenario(self, scenario: "ScenarioCfg", split: "Split") -> "ScenarioCfg":
        del split
        if not scenario.robots or not scenario.robots[0].fixed_base:
            raise ConfigError(
                "The channel 'robot' offsets an arm that is bolted down, and the robot of this task moves "
                "freely: it would fall. Vary another channel, such as only=sensor."
            )
        return scenario


def _robot_of(scene: Scene) -> "RobotCfg":
    if scene.scenario is None or not scene.scenario.robots:
        raise ConfigError("The channel 'robot' needs a scenario with a robot.")
    return scene.scenario.robots[0]


def _offsets(rng: np.random.Generator, allowed: tuple[tuple[int, ...], ...], count: int) -> tuple[float, ...]:
    """Draws offsets of ``count`` joints: of the first two in an allowed cell, of the others anywhere."""
    cell = allowed[int(rng.integers(len(allowed)))]
    shares = rng.uniform(0.0, 1.0, count)
    offsets = (2.0 * shares - 1.0) * BOUND_RAD
    for joint, (index, number) in enumerate(zip(cell, CELLS, strict=False)):
        # The middle 98 %: rounding never moves an offset into the next cell.
        inside = (index + 0.01 + 0.98 * shares[joint]) / number
        offsets[joint] = (2.0 * inside - 1.0) * BOUND_RAD
    return tuple(round(float(value), 6) for value in offsets)


def _free_posture(
    workspace: Workspace, state: "State", qpos: np.ndarray, candidates: tuple[tuple[float, ...], ...]
) -> np.ndarray:
    """Returns the first posture (J,) that touches nothing, within the joints' ranges and above the table."""
    robot = workspace.robot
    arm = list(robot.arm)
    low, high = np.array([robot.joints[index].range for index in arm]).T
    least_z = min(workspace.support_z_m + CLEARANCE_M, float(workspace.hand(qpos)[2]))
    for offsets in candidates:
        posture = qpos.copy()
        posture[arm] += offsets
        if ((posture[arm] < low) | (posture[arm] > high)).any():
            continue
        if workspace.hand(posture)[2] >= least_z and not workspace.touches(state, posture):
            return posture
    return qpos
