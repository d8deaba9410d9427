"""A LIBERO task as one of ours: a task file's scene, starts and goal."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller
from envs.core.errors import ConfigError
from envs.kinematics.waypoints import Waypoint
from envs.scenario import CameraCfg, RobotCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.libero import native
from envs.tasks.libero.catalogue import HORIZON, LEROBOT_HORIZONS, Entry
from envs.tasks.libero.goals import Goal
from envs.tasks.libero.scene import HOME, LiberoScene, scene_of
from envs.tasks.libero.starts import starts_of
from envs.tasks.native_spaces import NativeSpaces, Space
from envs.tasks.planner import Planner
from envs.tasks.tabletop import GRASP_OPEN_M, ee_pos


@dataclass(frozen=True, kw_only=True)
class LiberoTask(NativeSpaces):
    """One of LIBERO's 130 tasks, from its files (the extra ``libero``).

    Success is LIBERO's: the atoms of the task file's goal hold together at some step. Objects begin seated:
    see :mod:`envs.tasks.libero.seating`.

    Attributes:
        starts: ``regions`` draws places from the task file's regions; ``libero`` takes LIBERO's 50 initial
            states in turn, arm included: the k-th episode of either split begins in the k-th.
        action_space: ``joints`` for targets of all joints; ``native`` for robosuite's ``OSC_POSE``, whose arm
            is driven by torques; its expert is slower, and sees the hand in every step.
        observation_space: ``joints`` for positions of all joints and LIBERO's names of cameras; ``native``
            for LeRobot's observation of LIBERO; see :mod:`envs.tasks.libero.native`.
        horizon: Control steps after which an episode is cut off: 600 are those of LIBERO's own evaluation,
            and ``lerobot`` takes LeRobot's, 280 to 520 by suite.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    has_reward: ClassVar[bool] = False
    entry: ClassVar[Entry]
    native_names: ClassVar[tuple[str, ...]] = native.STATE_NAMES
    native_limits: ClassVar[tuple[tuple[float, ...], tuple[float, ...]]] = native.STATE_LIMITS

    starts: Literal["regions", "libero"] = "regions"
    horizon: int | Literal["lerobot"] = HORIZON

    def __post_init__(self) -> None:
        super().__post_init__()
        steps = LEROBOT_HORIZONS[self.entry.suite] if self.horizon == "lerobot" else self.horizon
        if not isinstance(steps, int) or steps < 1:
            raise ConfigError(
                f"horizon of {self.name} must be a number of control steps, or lerobot, given "
                f"{self.horizon!r}."
            )
        own: dict[str, object] = {"max_episode_steps": steps}
        own |= {"mirrored_images": True} if self.observation_space == "native" else {}
        for key, value in own.items():  # of this task, over those of its class
            object.__setattr__(self, key, value)

    @property
    def scene(self) -> LiberoScene:
        """The task file and what it became."""
        return scene_of(self.entry)

    @property
    def goal(self) -> Goal:
        """What has to hold."""
        return _goal_of(self.entry)

    @property
    @override
    def robot(self) -> RobotCfg:
        return _scenario_of(self.entry, self.action_space, self.observation_space).robots[0]

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        _goal_of(self.entry)  # raises before anything begins where a goal cannot be decided
        scenario = _scenario_of(self.entry, self.action_space, self.observation_space)
        own, robot = scenario.robots[0], self.robot
        if robot is own:
            return scenario
        return replace(scenario, robots=(robot,), cameras=_on_robot(scenario.cameras, own.name, robot))

    @override
    def native_controller(self) -> Controller:
        from envs.operational_space import OperationalSpaceController

        return OperationalSpaceController(self.robot)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        if self.starts == "libero":
            fixed = self._fixed
            return self._with_robot(fixed.select([int(rng.integers(fixed.num_envs)) for rng in rngs]))
        state = starts_of(self.entry).drawn(rngs)
        if self.action_space == "native":  # LIBERO's files have it half open, and evaluations open it first
            state.robots[self.robot.name].joint_pos[:, list(self.robot.fingers)] = GRASP_OPEN_M
        return self._with_robot(state)

    @property
    @override
    def num_fixed_starts(self) -> int:
        return 0 if self.starts == "regions" else starts_of(self.entry).fixed.num_envs

    @override
    def fixed_starts(self, indices: Sequence[int]) -> State:
        return self._with_robot(self._fixed.select(list(indices)))

    def fixed_start(self, index: int) -> State:
        """Returns one of LIBERO's 50 initial states, seated, as a state of one row.

        Raises:
            ConfigError: There is none of that index.
        """
        fixed = self._fixed
        if not 0 <= index < fixed.num_envs:
            raise ConfigError(f"{self.name} has {fixed.num_envs} fixed starts; given index {index}.")
        return self._with_robot(fixed.select([index]))

    @property
    def _fixed(self) -> State:
        if self.action_space == "native":
            return _after_waiting(self.entry)
        return starts_of(self.entry).fixed

    def _with_robot(self, state: State) -> State:
        """Puts another robot in the place of the scene's: as far from its rest as that one is."""
        own, robot = self.scene.robot, self.robot
        if robot.name == own.name:
            return state
        away = state.robots[own.name].joint_pos[:, list(own.arm)] - torch.tensor(HOME)[list(own.arm)]
        count = min(len(own.arm), len(robot.arm))
        qpos = torch.tensor(robot.default_qpos, dtype=away.dtype).repeat(len(away), 1)
        qpos[:, list(robot.arm[:count])] += away[:, :count]
        place = np.tile(robot.pos, (len(away), 1))
        arm = EntityState.at_rest(place, np.tile(robot.rot, (len(away), 1)), qpos.numpy())
        return State({robot.name: arm}, state.objects)

    @override
    def same_scene_tasks(self) -> tuple[str, ...]:
        from envs.tasks.libero.same_scene import same_scene_tasks

        return same_scene_tasks(self.entry)

    @override
    def success(self, state: State) -> Tensor:
        finite = torch.stack([entity.pos.isfinite().all(-1) for entity in state.objects.values()])
        return self.goal.met(state).all(-1) & finite.all(0)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns which share of the goal holds, below 1: LIBERO's own reward is success alone."""
        return 0.99 * self.goal.met(state).double().mean(-1)

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the hand's position, poses of all objects and joints of all fixtures, (N, D)."""
        parts = [ee_pos(state.robots[self.robot.name])]
        for name in (*self.scene.problem.objects, *self.scene.fixtures):
            entity = state.objects[name]
            parts += [entity.pos, entity.rot, entity.joint_pos]
        return torch.cat(parts, dim=-1)

    @override
    def native_state(self, robot: EntityState) -> Tensor:
        return native.native_state(self.robot, robot)

    @override
    def native_planner(self) -> Planner:
        from envs.tasks.pose_delta_planner import PoseDeltaPlanner

        return PoseDeltaPlanner(self.scenario, self.expert)

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        from envs.tasks.libero.expert import plan

        return plan(self.scene, self.goal, state, rng, self.robot.name)


def _on_robot(cameras: Sequence[CameraCfg], own: str, robot: RobotCfg) -> tuple[CameraCfg, ...]:
    """Returns cameras of which that on the hand is on another robot's."""
    mount = robot.camera_mount or robot.gripper_mount
    return tuple(
        replace(camera, mount=f"{robot.name}/{mount}")
        if camera.mount is not None and camera.mount.startswith(f"{own}/")
        else camera
        for camera in cameras
    )


@lru_cache(maxsize=8)
def _goal_of(entry: Entry) -> Goal:
    return Goal(scene_of(entry))


@lru_cache(maxsize=8)
def _after_waiting(entry: Entry) -> State:
    """Returns LIBERO's states with the arm where it is when an evaluation begins."""
    from envs.tasks.libero.waiting import joints_after_waiting

    fixed, (robot,) = starts_of(entry).fixed, _scenario_of(entry, "native", "joints").robots
    state = fixed.select(list(range(fixed.num_envs)))
    state.robots[robot.name].joint_pos = joints_after_waiting(robot, state.robots[robot.name].joint_pos)
    return state


@lru_cache(maxsize=8)
def _scenario_of(entry: Entry, action_space: Space, observation_space: Space) -> ScenarioCfg:
    """Returns a task's scene with the robot of its actions and the cameras of its observation."""
    scenario = scene_of(entry).scenario
    if action_space == "native":
        scenario = native.with_native_robot(scenario)
    return native.with_native_view(scenario) if observation_space == "native" else scenario
