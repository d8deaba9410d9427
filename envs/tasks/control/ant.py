"""Ant, after Isaac Lab (``manager_based/classic/ant/ant_env_cfg.py``, BSD 3-Clause; arXiv:2301.04195).

Reward, ends and starts are Isaac Lab's; progress, there the difference of two distances, is the velocity
towards the target. The observation is the one that Isaac Lab has for Newton: without the feet's contact
wrenches. Isaac Lab has no success; here an episode is one when its return reaches 60, about 3 m/s for 16 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, NormalizedPositionController
from envs.robots.ant import ANT, TORQUE_N_M
from envs.rotations import conjugate, rotate, uprightness, yaw_of
from envs.scenario import CameraCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.control.scene import CONTROL_60_HZ, LOOKS, STEP_S

TARGET_X_M = 1000.0
FALLEN_BELOW_M = 0.31
START_RAD, START_RAD_S = 0.2, 0.1
"""Half widths of the uniform offsets of the joints' starts."""

SOLVER = {"mujoco": {"cone": "elliptic", "impratio": 1.0}, "newton": {"impratio": 1.0}}
"""Friction pyramids of a leg on the ground lie another way in MuJoCo than in MuJoCo Warp."""

GROUND_HALF_SIZE_M = 200.0
"""Half the visible size, farther than a run of 16 s. Collisions have no such limit."""

_NEAR_LIMIT = 0.99


@dataclass(frozen=True, kw_only=True)
class Ant(Task):
    """Run along x on four legs."""

    name: ClassVar[str] = "control/ant"
    instructions: ClassVar[tuple[str, ...]] = ("run forwards",)
    max_episode_steps: ClassVar[int] = 960
    ends_on_success: ClassVar[bool] = False
    has_expert: ClassVar[bool] = False
    success_return: ClassVar[float | None] = 60.0

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        camera = CameraCfg(
            name="front", mount="ant/torso", turns=False, pos=(2.0, -3.0, 1.5), look_at=(0.0, 0.0, 0.0)
        )
        return ScenarioCfg(
            robots=(ANT,),
            cameras=(camera,),
            appearance=LOOKS,
            table=None,
            room=None,
            ground_half_size_m=GROUND_HALF_SIZE_M,
            physics=CONTROL_60_HZ,
            simulators=SOLVER,
        )

    @property
    @override
    def controller(self) -> Controller:
        return NormalizedPositionController(ANT)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        joints = len(ANT.joints)
        qpos = np.stack([ANT.default_qpos + rng.uniform(-START_RAD, START_RAD, joints) for rng in rngs])
        speed = np.stack([rng.uniform(-START_RAD_S, START_RAD_S, joints) for rng in rngs])
        robot = EntityState.at_rest(np.array(ANT.pos), np.tile(ANT.rot, (len(rngs), 1)), qpos)
        robot.joint_vel = torch.from_numpy(speed)
        robot.joint_target = torch.zeros((len(rngs), joints), dtype=torch.float64)
        return State({ANT.name: robot}, {})

    @override
    def success(self, state: State) -> Tensor:
        """Returns False: the return decides."""
        return torch.zeros(state.num_envs, dtype=torch.bool, device=state.device)

    @override
    def failure(self, state: State) -> Tensor:
        return state.robots[ANT.name].pos[:, 2] < FALLEN_BELOW_M

    def reward(self, state: State) -> Tensor:
        """Returns progress, being alive, posture and heading, less effort, per step, (N,)."""
        robot = state.robots[ANT.name]
        up, heading = _axes(robot)
        action, alive = _action(robot), 1.0 - self.failure(state).to(robot.pos.dtype)
        way = _to_target(robot)
        progress = (robot.lin_vel[:, :2] * way).sum(-1)
        towards = torch.where(heading > 0.8, 1.0, heading / 0.8)
        near = _normalized(robot).abs()
        at_limits = ((near > _NEAR_LIMIT) * (near - _NEAR_LIMIT) / (1.0 - _NEAR_LIMIT)).sum(-1)
        power = (action * robot.joint_vel).abs().sum(-1)
        reward = progress + 0.5 * alive + 0.1 * (up > 0.93) + 0.5 * towards
        return STEP_S * (reward - 0.005 * (action**2).sum(-1) - 0.05 * power - 0.1 * at_limits)

    def observe(self, state: State) -> Tensor:
        """Returns height, velocities in the body, yaw, roll, angle to the target, axes, joints, (N, 36)."""
        robot = state.robots[ANT.name]
        up, heading = _axes(robot)
        w, x, y, z = robot.rot.unbind(-1)
        roll = torch.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        yaw, way = yaw_of(robot.rot), _to_target(robot)
        angle = torch.atan2(way[:, 1], way[:, 0]) - yaw
        angle = torch.atan2(torch.sin(angle), torch.cos(angle))
        single = torch.stack((yaw, roll, angle, up, heading), dim=-1)
        body_vel = rotate(conjugate(robot.rot), robot.lin_vel)
        joints = (_normalized(robot), 0.2 * robot.joint_vel, _action(robot))
        return torch.cat((robot.pos[:, 2:], body_vel, robot.ang_vel, single, *joints), dim=-1)

    @override
    def rl_observation(self, state: State) -> Tensor:
        return self.observe(state)


def _action(robot: EntityState) -> Tensor:
    assert robot.joint_target is not None, "a simulator gives every robot's targets"
    return robot.joint_target / TORQUE_N_M


def _normalized(robot: EntityState) -> Tensor:
    """Returns joint positions with -1 and 1 at their limits, (N, 8)."""
    low, high = robot.joint_pos.new_tensor([joint.range for joint in ANT.joints]).T
    return 2.0 * (robot.joint_pos - low) / (high - low) - 1.0


def _axes(robot: EntityState) -> tuple[Tensor, Tensor]:
    """Returns how far the body's z axis points up, and its x axis to the target, in [-1, 1], (N,) each."""
    axis = robot.rot.new_tensor([1.0, 0.0, 0.0]).expand(len(robot.rot), 3)
    forward = rotate(robot.rot, axis)[:, :2]
    return uprightness(robot.rot), (forward * _to_target(robot)).sum(-1)


def _to_target(robot: EntityState) -> Tensor:
    """Returns the direction to the target in the plane, (N, 2)."""
    way = robot.pos.new_tensor([TARGET_X_M, 0.0]) - robot.pos[:, :2]
    return way / torch.linalg.vector_norm(way, dim=-1, keepdim=True)
