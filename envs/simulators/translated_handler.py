"""Base of simulators whose scene is translated from the compiled MuJoCo model of a scenario.

The bodies, joints and geoms of the model are translated once per environment. States are also kept in arrays
of the model's layout. So a state that is set is bit-identical when it is read, however the simulator stores
it, and every renderer of MuJoCo models can render it.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import override

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, SimulatorError, unknown_name
from envs.core.machine import num_cores
from envs.mjcf.drives import rest_targets
from envs.mjcf.layout import EntityLayout, as_slice, block, layout_of
from envs.mjcf.model import build_model
from envs.mjcf.objects import rest_joints
from envs.scenario import ScenarioCfg
from envs.scenario.simulator_settings import SimulatorSettings
from envs.simulators.base import EnvIds, TextureSource, index_of, rows_of
from envs.simulators.model_handler import ModelHandler, not_running
from envs.state import EntityState, State


class World(ABC):
    """One environment in the simulator; its arrays are one row of the handler's, in the model's layout."""

    @abstractmethod
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        """Sets the state of joints and free bodies, and resets warm-start state."""

    @abstractmethod
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        """Moves fixed objects and markers."""

    @abstractmethod
    def drive(self, ctrl: np.ndarray) -> None:
        """Sets the targets of the driven joints."""

    @abstractmethod
    def step(self, num_steps: int) -> None:
        """Advances time."""

    def step_towards(self, start: np.ndarray, end: np.ndarray, num_steps: int) -> None:
        """Advances time while the targets move evenly from ``start`` to ``end``, where they arrive."""
        for index in range(1, num_steps + 1):
            self.drive(start + (end - start) * np.float32(index / num_steps))
            self.step(1)

    @abstractmethod
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes the present positions and velocities into the row."""

    @abstractmethod
    def close(self) -> None:
        """Frees the environment."""


class TranslatedHandler[Settings: SimulatorSettings](ModelHandler):
    """N worlds and a copy of their states.

    Subclasses make the worlds; threads step several at once where ``steps_in_threads``.

    Attributes:
        takes_forces: Whether worlds drive joints by torques too, and not to positions alone.
        settings_class: Class of the simulator's settings.
        settings: The scenario's settings of this simulator, where there is such a class.
        model: The compiled scene, once launched.
        worlds: The environments, once launched.
    """

    dtype = torch.float32
    steps_in_threads: bool = False
    takes_forces: bool = False
    settings_class: type[Settings] | None = None
    settings: Settings

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        renderer: str | None = None,
        num_threads: int = 0,
        textures: TextureSource | None = None,
    ) -> None:
        name = renderer or next(iter(self.own_renderers), "warp")
        super().__init__(scenario, num_envs, renderer=name, num_threads=num_threads, textures=textures)
        if self.settings_class is not None:
            self.settings = self.settings_class.of(scenario)
        self.worlds: list[World] = []
        self._pool: ThreadPoolExecutor | None = None

    @abstractmethod
    def make_worlds(self, model: mujoco.MjModel) -> Sequence[World]:
        """Builds the environments."""

    @override
    def launch(self) -> None:
        for joint in (joint for robot in self.scenario.robots for joint in robot.joints):
            if joint.drive == "torque" and not self.takes_forces:
                raise SimulatorError(
                    f"This simulator drives joints to positions, and '{joint.name}' is driven by a torque. "
                    "Take another one, as in: simulator=mujoco"
                )
            if joint.pulls:
                raise SimulatorError(
                    f"This simulator drives single joints, and '{joint.name}' pulls a tendon over several. "
                    "Take another one, as in: simulator=mujoco, or simulator=mujoco_warp"
                )
        self.model = model = build_model(self.scenario)
        self._data = mujoco.MjData(model)
        self.layout = layout_of(model, self.scenario)
        self._entities = {item.name: item for item in (*self.layout.robots, *self.layout.objects)}
        self._robots = {item.name for item in self.layout.robots}
        self._readers = {
            name: (item, as_slice(item.qpos), as_slice(item.qvel), as_slice(item.ctrl))
            for name, item in self._entities.items()
        }
        self._resting: dict[int, tuple] = {}
        self._low, self._high = model.actuator_ctrlrange.astype(np.float32).T.copy()
        self._rest_rows()
        self.worlds = [*self.make_worlds(model)]
        if self.steps_in_threads and self.num_threads != 1 and self.num_envs > 1:
            self._pool = ThreadPoolExecutor(self.num_threads or num_cores(), thread_name_prefix="step")
        for row in range(self.num_envs):
            self._put(row)

    def _rest_rows(self) -> None:
        """Fills the arrays with the scenario at rest."""
        model, count = self.model, self.num_envs
        mocap = np.flatnonzero(model.body_mocapid >= 0)
        mocap = mocap[np.argsort(model.body_mocapid[mocap])]
        qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
        for robot, cfg in zip(self.layout.robots, self.scenario.robots, strict=True):
            qpos[robot.qpos] = cfg.default_qpos
            ctrl[robot.ctrl] = rest_targets(cfg)
        for item, cfg in zip(self.layout.objects, self.scenario.objects, strict=True):
            qpos[item.qpos] = rest_joints(cfg)
        rows = (qpos, np.zeros(model.nv), ctrl, model.body_pos[mocap], model.body_quat[mocap])
        self._qpos, self._qvel, self._ctrl, self._mocap_pos, self._mocap_quat = (
            np.repeat(np.asarray(row, np.float32)[None], count, axis=0) for row in rows
        )

    # -- states -------------------------------------------------------------------------------------

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        self._check_open()
        rows = index_of(env_ids)
        # Sliced as arrays: a slice of a tensor takes ten times as long.
        qpos, qvel, ctrl = (np.array(array[rows]) for array in (self._qpos, self._qvel, self._ctrl))
        tensor = torch.from_numpy
        state = State({}, {})
        for name, (item, joints, speeds, targets) in self._readers.items():
            root = self._root_state(item, qpos, qvel, rows)
            entity = EntityState(*root, tensor(qpos[:, joints]), tensor(qvel[:, speeds]))
            if name in self._robots:
                entity.joint_target = tensor(ctrl[:, targets])
                entity.ee_pos, entity.ee_rot = self._end_effector(item.ee_site, rows)
                state.robots[name] = entity
            else:
                state.objects[name] = entity
        return state

    def _root_state(
        self, item: EntityLayout, qpos: np.ndarray, qvel: np.ndarray, rows: slice | np.ndarray
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Returns position, orientation, linear and angular velocity of an entity's root."""
        tensor = torch.from_numpy
        if item.root == "free":
            at, speed = item.root_qpos, item.root_qvel
            pose = tensor(qpos[:, at : at + 3]), tensor(qpos[:, at + 3 : at + 7])
            return *pose, tensor(qvel[:, speed : speed + 3]), tensor(qvel[:, speed + 3 : speed + 6])
        bases, still = self._rest(len(qpos))
        if item.root == "mocap":
            pos, rot = self._mocap_pos[rows, item.mocap], self._mocap_quat[rows, item.mocap]
            return tensor(pos.copy()), tensor(rot.copy()), still, still
        return *bases[item.name], still, still

    def _rest(self, count: int) -> tuple[dict[str, tuple[Tensor, Tensor]], Tensor]:
        """Returns poses of fixed bases, and zero velocities, for ``count`` environments."""
        if count not in self._resting:
            bases = {
                item.name: tuple(
                    torch.from_numpy(np.tile(part.astype(np.float32), (count, 1)))
                    for part in (item.pos, item.rot)
                )
                for item in self.layout.robots
            }
            self._resting[count] = (bases, torch.zeros((count, 3), dtype=self.dtype))
        return self._resting[count]

    def _end_effector(self, site: int, rows: slice | np.ndarray) -> tuple[Tensor, Tensor]:
        """Returns position (n, 3) and orientation (n, 4) of a site, by forward kinematics."""
        model, data = self.model, self._data
        ids = range(self.num_envs)[rows] if isinstance(rows, slice) else rows.tolist()
        pos, rot = np.empty((len(ids), 3)), np.empty((len(ids), 4))
        for index, row in enumerate(ids):
            data.qpos[:] = self._qpos[row]
            data.mocap_pos[:], data.mocap_quat[:] = self._mocap_pos[row], self._mocap_quat[row]
            mujoco.mj_kinematics(model, data)
            pos[index] = data.site_xpos[site]
            mujoco.mju_mat2Quat(rot[index], data.site_xmat[site])
        return torch.from_numpy(pos.astype(np.float32)), torch.from_numpy(rot.astype(np.float32))

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        self._check_open()
        rows = rows_of(env_ids, self.num_envs)
        for name, entity in states.entities().items():
            if name not in self._entities:
                raise unknown_name("robot or object", name, self._entities)
            self._write(self._entities[name], entity, rows)
        for row in rows.tolist():
            self._put(row)

    def _write(self, item: EntityLayout, entity: EntityState, rows: np.ndarray) -> None:
        if entity.joint_pos.shape[-1] != len(item.qpos):
            raise ConfigError(
                f"'{item.name}' has {len(item.qpos)} joints; the state gives {entity.joint_pos.shape[-1]}."
            )
        columns = rows[:, None]
        if item.root == "free":
            self._qpos[columns, item.root_qpos + np.arange(7)] = _array(entity.pos, entity.rot)
            self._qvel[columns, item.root_qvel + np.arange(6)] = _array(entity.lin_vel, entity.ang_vel)
        elif item.root == "mocap":
            self._mocap_pos[rows, item.mocap] = _array(entity.pos)
            self._mocap_quat[rows, item.mocap] = _array(entity.rot)
        if len(item.qpos):
            self._qpos[columns, item.qpos] = _array(entity.joint_pos)
            self._qvel[columns, item.qvel] = _array(entity.joint_vel)
        if len(item.ctrl):
            target = entity.joint_target
            if target is None:
                target = item.held(entity.joint_pos)
            self._ctrl[columns, item.ctrl] = _array(target)

    def _put(self, row: int) -> None:
        world = self.worlds[row]
        world.place(self._mocap_pos[row], self._mocap_quat[row])
        world.put(self._qpos[row], self._qvel[row], self._ctrl[row])

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        rows = rows_of(env_ids, self.num_envs)
        placed = {item.name: item for item in self.layout.objects if item.root == "mocap"}
        for name, (pos, rot) in poses.items():
            if name not in placed:
                raise unknown_name("fixed object or marker", name, placed)
            self._mocap_pos[rows, placed[name].mocap] = np.asarray(pos)
            self._mocap_quat[rows, placed[name].mocap] = np.asarray(rot)
        for row in rows:
            self.worlds[row].place(self._mocap_pos[row], self._mocap_quat[row])

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        rows = index_of(env_ids)
        for name in self._robots & targets.keys():
            columns = self._readers[name][3]
            target = np.asarray(targets[name], np.float32)
            clipped = np.minimum(np.maximum(target, self._low[columns]), self._high[columns])
            self._ctrl[block(rows, columns)] = clipped

    # -- time ---------------------------------------------------------------------------------------

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        self._check_open()
        self._advance(None, num_steps, env_ids)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self._check_open()
        start = self._ctrl.copy()
        self.set_joint_targets(targets, env_ids)
        self._advance(start, num_steps, env_ids)

    def _advance(self, start: np.ndarray | None, num_steps: int, env_ids: EnvIds) -> None:
        rows = rows_of(env_ids, self.num_envs).tolist()
        self.step_worlds(rows, start, num_steps)
        if not math.isfinite(self._qpos.sum()):
            bad = [row for row in rows if not np.isfinite(self._qpos[row]).all()]
            if not bad:  # one that was not stepped, and was reported before
                return
            raise SimulatorError(
                f"The state of environments {bad} is no longer finite. "
                "Check the actions, or give physics.timestep_s a smaller value."
            )

    def step_worlds(self, rows: Sequence[int], start: np.ndarray | None, num_steps: int) -> None:
        """Advances environments to their present targets, and reads their states.

        Args:
            rows: Environments.
            start: Targets from which those of all environments move evenly, (N, nu); None if they stay.
            num_steps: Physics steps.
        """

        def advance(row: int) -> None:
            world = self.worlds[row]
            if start is None:
                world.drive(self._ctrl[row])
                world.step(num_steps)
            else:
                world.step_towards(start[row], self._ctrl[row], num_steps)
            world.read(self._qpos[row], self._qvel[row])

        if self._pool is None or len(rows) == 1:
            for row in rows:
                advance(row)
        else:
            list(self._pool.map(advance, rows))

    @override
    def _check_open(self) -> None:
        if not self.worlds:
            raise not_running()

    @override
    def close(self) -> None:
        super().close()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
        for world in self.worlds:
            world.close()
        self.worlds = []


def _array(*tensors: Tensor) -> np.ndarray:
    return torch.cat(tensors, -1).detach().cpu().numpy().astype(np.float32)
