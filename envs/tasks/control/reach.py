"""Franka reach, after Isaac Lab (``manipulation/reach/reach_env_cfg.py``, BSD 3-Clause; arXiv:2301.04195).

Commands, starts, reward and control are Isaac Lab's, but for what a state of this project does not have or
need: an action of 1 is 2.5 rad, for Isaac Lab's actions have no bounds and ours do; an episode is one command
of 4 s, of the three of Isaac Lab's 12 s; the last action is the present joint targets, so that its rate of
change, weighted by 0.0001, is not punished; observations have no noise; the pose is that of the point between
the fingers, of an arm with this project's gains. Isaac Lab has no success; here it is to end within 5 cm and
0.2 rad of the command.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, OffsetPositionController
from envs.robots.franka import FRANKA
from envs.rotations import conjugate, from_euler, multiply
from envs.scenario import GeomCfg, ObjectCfg, PhysicsCfg, RobotCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.parameters import interval, parameter
from envs.tasks.robot_columns import columns_of
from envs.tasks.tabletop import FRONT_CAMERA, TABLETOP_LOOKS, distance, ee_pos

HOME = (0.0, -0.569, 0.0, -2.810, 0.0, 3.037, 0.741, 0.04, 0.04)
"""``isaaclab_assets/robots/franka.py``."""

ROBOT = FRANKA.with_home(HOME)

ACTION_RAD = 2.5
"""Isaac Lab scales by 0.5 an action without bounds. Targets within 0.5 rad of the rest reach 7 % of the
commands, within 1 rad 43, 1.5 rad 77, 2 rad 97, and within 2.5 all of 400, by inverse kinematics from twelve
starts each."""

PHYSICS = PhysicsCfg(timestep_s=1.0 / 300.0, decimation=10)
"""Isaac Lab's 30 Hz; its two steps of 1/60 s are too long for MuJoCo with this arm's gains."""

CAMERA = dataclasses.replace(FRONT_CAMERA, pos=(2.2, 0.9, 0.9), look_at=(0.3, 0.0, 0.3), fovy_deg=30.0)

STEP_S = PHYSICS.timestep_s * PHYSICS.decimation


@dataclass(frozen=True, kw_only=True)
class FrankaReach(Task):
    """Bring the hand of a Panda to a commanded pose, pointing down.

    Attributes:
        command_x_m: Range of the commanded position in x, m.
        command_y_m: The same in y.
        command_z_m: The same in z.
        start_scale: Range of the factor of each joint's rest position at the start.
        near_m: Distance from the command that counts as reached, m.
        near_rad: Angle from it that does, rad.
    """

    name: ClassVar[str] = "control/franka_reach"
    instructions: ClassVar[tuple[str, ...]] = ("move the hand to the marker",)
    max_episode_steps: ClassVar[int] = 120
    ends_on_success: ClassVar[bool] = False
    has_expert: ClassVar[bool] = False

    command_x_m: tuple[float, float] = interval((0.35, 0.65), at_least=0.2, at_most=0.8)
    command_y_m: tuple[float, float] = interval((-0.2, 0.2), at_least=-0.6, at_most=0.6)
    command_z_m: tuple[float, float] = interval((0.15, 0.5), at_least=0.05, at_most=0.9)
    start_scale: tuple[float, float] = interval((0.5, 1.5), at_least=0.0, at_most=2.0)
    near_m: float = parameter(0.05, above=0.0, at_most=0.5)
    near_rad: float = parameter(0.2, above=0.0, at_most=pi)

    @property
    @override
    def robot(self) -> RobotCfg:
        return ROBOT

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        goal = ObjectCfg(
            name="goal",
            kind="marker",
            geoms=(
                GeomCfg(shape="sphere", size=(0.02,), rgba=(0.1, 0.8, 0.15, 1.0)),
                GeomCfg(
                    shape="box", size=(0.05, 0.008, 0.008), pos=(0.05, 0.0, 0.0), rgba=(0.85, 0.1, 0.1, 1.0)
                ),
            ),
            pos=(0.5, 0.0, 0.3),
        )
        return ScenarioCfg(
            robots=(self.robot,),
            objects=(goal,),
            cameras=(CAMERA,),
            appearance=TABLETOP_LOOKS,
            table=TableCfg(pos=(0.4, 0.0, 0.0), half_size=(0.8, 0.8)),
            physics=PHYSICS,
        )

    @property
    @override
    def controller(self) -> Controller:
        return OffsetPositionController(self.robot, ACTION_RAD)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        count, own, arm = len(rngs), self.robot, list(self.robot.arm)
        low, high = np.array([joint.range for joint in own.joints]).T
        qpos, pos, yaw = (
            np.tile(np.array(own.default_qpos), (count, 1)),
            np.empty((count, 3)),
            np.empty(count),
        )
        nearest, farthest = zip(self.command_x_m, self.command_y_m, self.command_z_m, strict=True)
        for row, rng in enumerate(rngs):
            qpos[row, arm] *= rng.uniform(*self.start_scale, len(arm))
            pos[row] = rng.uniform(nearest, farthest)
            yaw[row] = rng.uniform(-pi, pi)
        rot = from_euler(np.stack([yaw, np.full(count, pi), np.zeros(count)], axis=-1))
        robot = EntityState.at_rest(np.array(own.pos), np.tile(own.rot, (count, 1)), np.clip(qpos, low, high))
        return State({own.name: robot}, {"goal": EntityState.at_rest(pos, rot)})

    @override
    def success(self, state: State) -> Tensor:
        off, turn = self._errors(state)
        return (off <= self.near_m) & (turn <= self.near_rad)

    def reward(self, state: State) -> Tensor:
        """Returns nearness, less both errors and joint speeds, per step, (N,)."""
        off, turn = self._errors(state)
        speeds = (state.robots[self.robot.name].joint_vel ** 2).sum(-1)
        reward = -0.2 * off + 0.1 * (1.0 - torch.tanh(off / 0.1)) - 0.1 * turn - 0.0001 * speeds
        return STEP_S * reward

    def observe(self, state: State) -> Tensor:
        """Returns joints from their rest, their speeds, the command, and the last action, (N, 32)."""
        robot, goal = state.robots[self.robot.name], state.objects["goal"]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        rest, columns = robot.joint_pos.new_tensor(self.robot.default_qpos), columns_of(self.robot)
        action = (robot.joint_target[:, columns.arm_targets] - rest[columns.arm]) / ACTION_RAD
        return torch.cat((robot.joint_pos - rest, robot.joint_vel, goal.pos, goal.rot, action), dim=-1)

    @override
    def rl_observation(self, state: State) -> Tensor:
        return self.observe(state)

    def _errors(self, state: State) -> tuple[Tensor, Tensor]:
        """Returns how far the hand is from the command, m and rad, (N,) each."""
        robot, goal = state.robots[self.robot.name], state.objects["goal"]
        assert robot.ee_rot is not None, "a simulator gives every robot's end effector"
        between = multiply(goal.rot, conjugate(robot.ee_rot))
        turn = 2.0 * torch.atan2(torch.linalg.vector_norm(between[:, 1:], dim=-1), between[:, 0].abs())
        return distance(ee_pos(robot), goal.pos), turn
