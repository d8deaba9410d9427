"""MuJoCo on CPU: N environments of one model, stepped by native threads."""

import functools
import math
from collections.abc import Mapping
from typing import Unpack, override

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from torch import Tensor

from envs.core.errors import ConfigError, SimulatorError, unknown_name
from envs.mjcf.drives import rest_targets
from envs.mjcf.layout import EntityLayout, as_slice, block, layout_of
from envs.mjcf.model import build_models
from envs.mjcf.objects import rest_joints
from envs.scenario import ScenarioCfg
from envs.simulators.base import EnvIds, HandlerOptions, index_of, rows_of
from envs.simulators.model_handler import ModelHandler, not_running
from envs.simulators.mujoco.lazy_state import ReadEntity, StateArrays, readers_of
from envs.state import EntityState, State

_POSITION_STAGE = int(mujoco.mjtStage.mjSTAGE_POS)


class MujocoHandler(ModelHandler):
    """One ``mujoco.batch.Batch``: the result is the same for any number of environments and threads.

    Args:
        scenario: The scene.
        num_envs: Number of environments.
        simplify_meshes: Render the robots with simplified meshes.
        **options: ``renderer``, ``num_threads``, ``textures``; see :class:`~envs.simulators.base.Handler`.

    Attributes:
        model: The model that is rendered.
        physics_model: The model that is simulated: without visual geoms.
    """

    own_renderers = ("warp", "gl", "filament", "sapien")

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        simplify_meshes: bool = True,
        **options: Unpack[HandlerOptions],
    ) -> None:
        super().__init__(scenario, num_envs, **options)
        self._simplify_meshes = simplify_meshes
        self._batch: Batch | None = None

    @override
    def launch(self) -> None:
        self.model, self.physics_model = build_models(self.scenario, simplify=self._simplify_meshes)
        # A state that has diverged must be reported, not replaced by the initial one.
        self.physics_model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._batch = Batch(self.physics_model, self.num_envs, self.num_threads)
        self.layout = layout_of(self.model, self.scenario)
        self._qpos, self._qvel = self._batch.qpos, self._batch.qvel
        self._ctrl, self._mocap_pos = self._batch.ctrl, self._batch.mocap_pos
        self._mocap_quat, self._warmstart = self._batch.mocap_quat, self._batch.qacc_warmstart
        self._arrays = [self._batch.bind(name) for name in StateArrays.__slots__]
        self._robots, self._objects = (
            {entity.name: readers_of(entity, len(entity.qpos)) for entity in entities}
            for entities in (self.layout.robots, self.layout.objects)
        )
        for robot, cfg in zip(self.layout.robots, self.scenario.robots, strict=True):
            self._qpos[:, robot.qpos] = cfg.default_qpos
            self._ctrl[:, robot.ctrl] = rest_targets(cfg)
        for layout, item in zip(self.layout.objects, self.scenario.objects, strict=True):
            self._qpos[:, layout.qpos] = rest_joints(item)
        low, high = self.model.actuator_ctrlrange.T.copy()
        self._drives = {  # robot to the columns of its targets, and their limits
            robot.name: (columns := as_slice(robot.ctrl), low[columns], high[columns])
            for robot in self.layout.robots
        }
        self._batch.forward(stage=_POSITION_STAGE)

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        arrays = StateArrays.of(self._arrays, _chosen(env_ids))
        return State(
            {name: ReadEntity(arrays, readers) for name, readers in self._robots.items()},
            {name: ReadEntity(arrays, readers) for name, readers in self._objects.items()},
        )

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        rows = rows_of(env_ids, self.num_envs)
        layouts = {entity.name: entity for entity in (*self.layout.robots, *self.layout.objects)}
        for name, entity in states.entities().items():
            if name not in layouts:
                raise unknown_name("robot or object", name, layouts)
            self._write(layouts[name], entity, rows)
        self._warmstart[rows] = 0.0
        self._running.forward(rows, stage=_POSITION_STAGE)

    def _write(self, layout: EntityLayout, entity: EntityState, rows: np.ndarray) -> None:
        columns = rows[:, None]
        if layout.root == "free":
            position = layout.root_qpos + np.arange(7)
            speed = layout.root_qvel + np.arange(6)
            self._qpos[columns, position] = torch.cat([entity.pos, entity.rot], -1)
            self._qvel[columns, speed] = torch.cat([entity.lin_vel, entity.ang_vel], -1)
        elif layout.root == "mocap":
            self._mocap_pos[rows, layout.mocap] = entity.pos
            self._mocap_quat[rows, layout.mocap] = entity.rot
        if entity.joint_pos.shape[-1] != len(layout.qpos):
            raise ConfigError(
                f"'{layout.name}' has {len(layout.qpos)} joints; "
                f"the state gives {entity.joint_pos.shape[-1]}."
            )
        if len(layout.qpos):
            self._qpos[columns, layout.qpos] = entity.joint_pos
            self._qvel[columns, layout.qvel] = entity.joint_vel
        if len(layout.ctrl):
            target = entity.joint_target
            if target is None:
                target = layout.held(entity.joint_pos)
            self._ctrl[columns, layout.ctrl] = target

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        rows = index_of(env_ids)
        placed = {item.name: item for item in self.layout.objects if item.root == "mocap"}
        for name, (pos, rot) in poses.items():
            if name not in placed:
                raise unknown_name("fixed object or marker", name, placed)
            self._mocap_pos[rows, placed[name].mocap] = np.asarray(pos)
            self._mocap_quat[rows, placed[name].mocap] = np.asarray(rot)

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        rows = index_of(env_ids)
        for robot, target in targets.items():
            if robot not in self._drives:
                raise unknown_name("robot", robot, self._drives)
            columns, low, high = self._drives[robot]
            raised = np.maximum(np.asarray(target), low)  # 3× faster than np.clip
            self._ctrl[block(rows, columns)] = np.minimum(raised, high)

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        try:
            self._running.step(_chosen(env_ids), nstep=num_steps, stage=_POSITION_STAGE)
        except SimulationError as error:
            raise _stopped(error) from error
        self._check_finite(env_ids)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        rows = index_of(env_ids)
        left, made = _shares(num_steps)
        way = self._ctrl[rows][:, None] * left  # (n, num_steps, nu)
        self.set_joint_targets(targets, env_ids)
        way += self._ctrl[rows][:, None] * made
        try:
            self._running.rollout(num_steps, way, record=(), ids=_chosen(env_ids))
            self._running.forward(_chosen(env_ids), stage=_POSITION_STAGE)
        except SimulationError as error:
            raise _stopped(error) from error
        self._check_finite(env_ids)

    def _check_finite(self, env_ids: EnvIds) -> None:
        qpos = self._qpos[index_of(env_ids)]
        # The sum is finite exactly when every entry is (no overflow at physical magnitudes).
        if not math.isfinite(np.add.reduce(qpos, axis=None)):
            bad = np.flatnonzero(~np.isfinite(self._qpos).all(axis=1))
            raise SimulatorError(
                f"The state of environments {bad.tolist()} is no longer finite. "
                "Check the actions, or give physics.timestep_s a smaller value."
            )

    @property
    def _running(self) -> Batch:
        if self._batch is None:
            raise not_running()
        return self._batch

    @override
    def _check_open(self) -> None:
        self._running  # noqa: B018 (says so when nothing runs)

    @override
    def close(self) -> None:
        super().close()
        self._batch = None


def _chosen(env_ids: EnvIds) -> np.ndarray | None:
    """Returns environments in MuJoCo's form, in which None means all."""
    rows = index_of(env_ids)
    return None if isinstance(rows, slice) else rows


def _stopped(error: SimulationError) -> SimulatorError:
    return SimulatorError(f"MuJoCo stopped in environments {error.ids.tolist()}: {error}")


@functools.cache
def _shares(num_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns how much of its way a target has left and has made in each step, both (num_steps, 1)."""
    made = np.arange(1, num_steps + 1)[:, None] / num_steps
    return 1.0 - made, made
