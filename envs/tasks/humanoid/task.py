"""Base of HumanoidBench's tasks of the H1: scene, observation, control, ends, start."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, NormalizedPositionController
from envs.kinematics.body_poses import BodyTree
from envs.robots.h1 import STAND_HEIGHT_M, h1_of
from envs.robots.h1_hand import h1_hand_of
from envs.scenario import (
    Appearance,
    CameraCfg,
    LightCfg,
    ObjectCfg,
    PhysicsCfg,
    RobotCfg,
    ScenarioCfg,
    SurfaceMaterial,
    Vec3,
)
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.humanoid.measures import Measures, measure

ROBOT = "h1"
"""Name of the robot without hands."""

RESET_NOISE = 0.01
"""Half width of the uniform noise on every number of the initial ``qpos``: ``env.py``, DEFAULT_RANDOMNESS."""

CONTROL_50_HZ = PhysicsCfg(timestep_s=0.002, decimation=10)
"""``tasks.py``, frame_skip, and ``envs/h1_pos_walk.xml``, timestep."""

SOLVER = {
    "mujoco": {"integrator": "euler", "cone": "pyramidal", "impratio": 1.0, "iterations": 100},
    "mujoco_warp": {"nconmax": 64, "njmax": 320},
}
"""MuJoCo's defaults, as the published scenes leave them. A robot on the ground has up to 40 contacts."""

SOLVER_WITH_HANDS = {**SOLVER, "mujoco_warp": {"nconmax": 160, "njmax": 800}}
"""The same with hands, of which 48 joints have dry friction, a constraint each."""

LOOKS = Appearance(
    materials={
        "ground": SurfaceMaterial(rgb=(0.62, 0.64, 0.66), roughness=0.9, specular=0.05),
        "wall": SurfaceMaterial(rgb=(0.75, 0.75, 0.72), roughness=0.9, specular=0.0),
    },
    lights=(LightCfg(kind="distant", direction=(-0.3, -0.4, -1.0), intensity=0.8, cast_shadow=True),),
)

GROUND_HALF_SIZE_M = 200.0
"""Half the visible size, farther than a run of 20 s; ``common/floor.xml`` has 20 m."""


@dataclass(frozen=True, kw_only=True)
class HumanoidTask(Task):
    """A task of HumanoidBench.

    An episode is a success when its return reaches the published bar; a fall ends it as a failure.

    Attributes:
        model: HumanoidBench's own folder of assets, whose robot is taken; empty is the one of the package
            ``robosuite_models``, with the published numbers, and with hands that of ``roboverse assets get
            humanoid_bench``.
    """

    max_episode_steps: ClassVar[int] = 1000
    ends_on_success: ClassVar[bool] = False
    has_expert: ClassVar[bool] = False

    start_pos: ClassVar[Vec3] = (0.0, 0.0, STAND_HEIGHT_M)
    """Initial position of the pelvis, m."""

    fallen_below_m: ClassVar[float | None] = 0.2
    """Height of the pelvis below which an episode is lost."""

    camera_pos: ClassVar[Vec3] = (2.0, 3.0, 0.8)
    """Position of the tracking camera relative to the pelvis, m: cam_default of ``h1_pos.xml``."""

    feels: ClassVar[tuple[str, ...]] = ()
    """Objects whose contacts with the robot the task needs."""

    has_hands: ClassVar[bool] = False
    """Whether the H1 has hands."""

    model: str = ""

    @property
    def robot(self) -> RobotCfg:
        """The H1."""
        return dataclasses.replace(self._published, pos=self.start_pos, feels=self.feels)

    @property
    def _published(self) -> RobotCfg:
        """The robot as HumanoidBench has it."""
        return h1_hand_of(self.model) if self.has_hands else h1_of(self.model)

    @property
    def _name(self) -> str:
        return "h1_hand" if self.has_hands else ROBOT

    @property
    def objects(self) -> tuple[ObjectCfg, ...]:
        """Further objects of the scene."""
        return ()

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return ScenarioCfg(
            robots=(self.robot,),
            objects=self.objects,
            cameras=(
                CameraCfg(
                    name="front",
                    mount=f"{self._name}/pelvis",
                    turns=False,
                    pos=self.camera_pos,
                    look_at=(0.0, 0.0, 0.0),
                ),
            ),
            appearance=LOOKS,
            table=None,
            room=None,
            ground_half_size_m=GROUND_HALF_SIZE_M,
            physics=CONTROL_50_HZ,
            simulators=SOLVER_WITH_HANDS if self.has_hands else SOLVER,
        )

    @property
    @override
    def controller(self) -> Controller:
        return NormalizedPositionController(self.robot)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        """Returns the published posture with uniform noise on every number; quaternions are normalized."""
        robot, moving = self.robot, self._moving
        rest = [*robot.pos, *robot.rot, *robot.default_qpos]
        joints = len(rest)
        for item in moving:
            rest += [*item.pos, *item.rot]
        qpos = np.array(rest) + np.zeros((len(rngs), 1))
        for row, rng in zip(qpos, rngs, strict=True):
            row += rng.uniform(-RESET_NOISE, RESET_NOISE, len(rest))
            self.place(rng, row)
        # Published episodes begin with targets of zero; the first action replaces them before a step.
        objects = {
            item.name: EntityState.at_rest(*_pose(qpos[:, joints + 7 * index :]))
            for index, item in enumerate(moving)
        }
        return State({self._name: EntityState.at_rest(*_pose(qpos), qpos[:, 7:joints])}, objects)

    def place(self, rng: np.random.Generator, qpos: np.ndarray) -> None:
        """Changes one sampled ``qpos`` further; does nothing by default."""

    @property
    def _moving(self) -> list[ObjectCfg]:
        return [item for item in self.objects if item.kind == "free"]

    @override
    def success(self, state: State) -> Tensor:
        """Returns False: the return decides."""
        return torch.zeros(state.num_envs, dtype=torch.bool, device=state.device)

    @override
    def failure(self, state: State) -> Tensor:
        if self.fallen_below_m is None:
            return super().failure(state)
        return state.robots[self._name].pos[:, 2] < self.fallen_below_m

    def observe(self, state: State) -> Tensor:
        """Returns all positions, then all velocities, as MuJoCo's ``qpos`` and ``qvel`` have them.

        The robot's place, orientation and 19 joints (69 with hands), then what moves beside it; linear
        velocities are the world's, angular ones the body's: (N, 51) or (N, 151), and 13 more for each free
        object.
        """
        robot = state.robots[self._name]
        qpos = [robot.pos, robot.rot, robot.joint_pos]
        qvel = [robot.lin_vel, robot.ang_vel, robot.joint_vel]
        for item in (state.objects[cfg.name] for cfg in self._moving):
            qpos += [item.pos, item.rot]
            qvel += [item.lin_vel, item.ang_vel]
        return torch.cat([*qpos, *qvel], dim=-1)

    @override
    def rl_observation(self, state: State) -> Tensor:
        return self.observe(state)

    def measures(self, state: State) -> Measures:
        """Returns what the rewards are made of."""
        robot, cfg = state.robots[self._name], self._published
        return measure(_tree(cfg, robot.pos.device, robot.pos.dtype), cfg, robot)


def _pose(qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions (N, 3) and normalized orientations (N, 4) of the first seven numbers."""
    rot = qpos[:, 3:7]
    return qpos[:, :3], rot / np.linalg.norm(rot, axis=-1, keepdims=True)


@lru_cache(maxsize=8)
def _tree(robot: RobotCfg, device: torch.device, dtype: torch.dtype) -> BodyTree:
    return BodyTree(robot, device, dtype)
