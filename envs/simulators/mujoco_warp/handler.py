"""MuJoCo Warp as a :class:`~envs.simulators.base.Handler`: N worlds on one device, in float32."""

import logging
from collections.abc import Mapping, Sequence
from typing import Unpack, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name
from envs.mjcf.drives import rest_targets
from envs.mjcf.layout import EntityLayout, as_slice, layout_of
from envs.mjcf.model import build_models
from envs.mjcf.objects import rest_joints
from envs.rotations import from_matrix
from envs.scenario import ScenarioCfg
from envs.simulators.base import EnvIds, HandlerOptions, rows_of
from envs.simulators.model_handler import ModelHandler, not_running
from envs.simulators.mujoco.render import RenderJob
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.simulators.mujoco_warp.snapshots import Snapshots
from envs.simulators.mujoco_warp.tracer import BatchTracer, Images
from envs.simulators.mujoco_warp.worlds import Worlds, WorldViews
from envs.state import EntityState, State

logger = logging.getLogger(__name__)

_TRACED = "warp"
"""The renderer that runs on the physics' device; every other one gets snapshots on the CPU."""


class MujocoWarpHandler(ModelHandler):
    """MuJoCo Warp: all worlds step together.

    On a CPU a world is bit-identical for any number of worlds. On a GPU contacts are found in any order, so
    two runs agree to rounding only; see ``deterministic`` in the settings.

    States are float32 tensors on the device. A state that is set is rounded to float32 once. A world whose
    state is no longer finite returns to the last state that was set, without an effect on the others: see
    :attr:`num_resets`.

    Args:
        scenario: The scene; its block ``simulators["mujoco_warp"]`` is a
            :class:`~envs.simulators.mujoco_warp.settings.WarpSettings`.
        num_envs: Number of environments.
        simplify_meshes: Render the robots with simplified meshes.
        **options: ``renderer``, ``num_threads``, ``textures``; see :class:`~envs.simulators.base.Handler`.

    Attributes:
        settings: Sizes of the buffers.
        model: The model that is rendered.
        physics_model: The model that is simulated: without visual geoms.
        on: The device, once launched.
        worlds: The physics, once launched.
    """

    own_renderers = ("warp", "gl", "filament", "sapien")
    dtype = torch.float32
    steps_together = True

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        simplify_meshes: bool = True,
        **options: Unpack[HandlerOptions],
    ) -> None:
        super().__init__(scenario, num_envs, **options)
        self.settings = WarpSettings.of(scenario)
        self._simplify_meshes = simplify_meshes
        self.worlds: Worlds | None = None
        self._tracer: BatchTracer | None = None

    @override
    def launch(self) -> None:
        self.on = device = Device(self.settings.device)
        self.device = device.torch
        self.model, self.physics_model = build_models(
            self.scenario, simplify=self._simplify_meshes, prune=True
        )
        self.layout = layout_of(self.model, self.scenario)
        self.worlds = Worlds(self.physics_model, self.num_envs, device, self.settings)
        self._entities = (*self.layout.robots, *self.layout.objects)
        self._columns = {
            entity.name: tuple(self._index(part) for part in (entity.qpos, entity.qvel, entity.ctrl))
            for entity in self._entities
        }
        bounds = torch.from_numpy(self.model.actuator_ctrlrange.T.copy())
        self._low, self._high = bounds.to(device=self.device, dtype=self.dtype)
        self._rests: dict[int, tuple[Tensor, Tensor]] = {}
        self._bases = {r.name: (self._float(r.pos), self._float(r.rot)) for r in self.layout.robots}
        views = self.worlds.views
        for robot, cfg in zip(self.layout.robots, self.scenario.robots, strict=True):
            joints, _, targets = self._columns[robot.name]
            views.qpos[:, joints] = self._float(cfg.default_qpos)
            views.ctrl[:, targets] = self._float(rest_targets(cfg))
        for layout, item in zip(self.layout.objects, self.scenario.objects, strict=True):
            views.qpos[:, self._columns[layout.name][0]] = self._float(rest_joints(item))
        with device.scope():
            self.worlds.begin(slice(None))

    def _index(self, addresses: np.ndarray) -> slice | Tensor:
        columns = as_slice(addresses)
        return columns if isinstance(columns, slice) else torch.from_numpy(columns).to(self.device)

    def _float(self, values: object) -> Tensor:
        if isinstance(values, np.ndarray):
            values = np.ascontiguousarray(values)
        return torch.as_tensor(values).to(device=self.device, dtype=self.dtype)

    @property
    def _running(self) -> Worlds:
        if self.worlds is None:
            raise not_running()
        return self.worlds

    @override
    def _check_open(self) -> None:
        self._running  # noqa: B018 (says so when nothing runs)

    @property
    def views(self) -> WorldViews:
        """The simulator's own memory, without a copy: for loops in which a copy counts."""
        return self._running.views

    @property
    def num_resets(self) -> Tensor:
        """Number of resets of each environment because its state was not finite, (N,) int64."""
        return self._running.num_resets

    # -- states -------------------------------------------------------------------------------------

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        views, rows = self._running.views, self.on.rows(env_ids)
        with self.on.scope():
            qpos, qvel, ctrl = (value[rows].clone() for value in (views.qpos, views.qvel, views.ctrl))
            robots = {r.name: self._robot_state(r, qpos, qvel, ctrl, rows) for r in self.layout.robots}
            objects = {o.name: self._object_state(o, qpos, qvel, rows) for o in self.layout.objects}
        return State(robots, objects)

    def _robot_state(self, robot: EntityLayout, qpos, qvel, ctrl, rows) -> EntityState:
        views, (joints, speeds, targets) = self._running.views, self._columns[robot.name]
        pos, rot, lin_vel, ang_vel = self._root_state(robot, qpos, qvel)
        return EntityState(
            pos=pos,
            rot=rot,
            lin_vel=lin_vel,
            ang_vel=ang_vel,
            joint_pos=qpos[:, joints],
            joint_vel=qvel[:, speeds],
            joint_target=ctrl[:, targets],
            ee_pos=views.site_xpos[rows, robot.ee_site].clone(),
            ee_rot=from_matrix(views.site_xmat[rows, robot.ee_site]),
            touched=self._touched(robot, rows),
        )

    def _touched(self, entity: EntityLayout, rows) -> Tensor | None:
        if not len(entity.touches):
            return None
        return (self._running.views.sensordata[rows][:, entity.touches] > 0.0).to(self.dtype)

    def _root_state(
        self, entity: EntityLayout, qpos: Tensor, qvel: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Returns position, orientation, linear and angular velocity of what moves freely or is bolted."""
        if entity.root == "free":
            pose, speed = qpos[:, entity.root_qpos :], qvel[:, entity.root_qvel :]
            return pose[:, :3], pose[:, 3:7], speed[:, :3], speed[:, 3:6]
        count = len(qpos)
        still, _ = self._rest(count)
        pos, rot = self._bases[entity.name]
        return pos.expand(count, 3), rot.expand(count, 4), still, still

    def _object_state(self, item: EntityLayout, qpos, qvel, rows) -> EntityState:
        views, (joints, speeds, _) = self._running.views, self._columns[item.name]
        still, none = self._rest(len(qpos))
        joint_pos, joint_vel = (qpos[:, joints], qvel[:, speeds]) if len(item.qpos) else (none, none)
        if item.root == "free":
            root = self._root_state(item, qpos, qvel)
            return EntityState(*root, joint_pos, joint_vel, touched=self._touched(item, rows))
        pos = views.mocap_pos[rows, item.mocap].clone()
        rot = views.mocap_quat[rows, item.mocap].clone()
        touched = self._touched(item, rows)
        return EntityState(pos, rot, still, still, joint_pos, joint_vel, touched=touched)

    def _rest(self, count: int) -> tuple[Tensor, Tensor]:
        """Returns what never changes: zero velocities, and the joints of what has none."""
        if count not in self._rests:
            zeros = torch.zeros((count, 3), device=self.device)
            self._rests[count] = (zeros, zeros[:, :0])
        return self._rests[count]

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        worlds = self._running
        rows = self.on.rows(range(self.num_envs) if env_ids is None else env_ids)
        layouts = {entity.name: entity for entity in self._entities}
        with self.on.scope():
            for name, entity in states.entities().items():
                if name not in layouts:
                    raise unknown_name("robot or object", name, layouts)
                self._write(layouts[name], entity, rows)
            worlds.begin(rows)

    def _write(self, layout: EntityLayout, entity: EntityState, rows: Tensor) -> None:
        views, (joints, speeds, targets) = self._running.views, self._columns[layout.name]
        if entity.joint_pos.shape[-1] != len(layout.qpos):
            given = entity.joint_pos.shape[-1]
            raise ConfigError(f"'{layout.name}' has {len(layout.qpos)} joints; the state gives {given}.")
        if layout.root == "free":
            pose = torch.cat([self._float(entity.pos), self._float(entity.rot)], -1)
            speed = torch.cat([self._float(entity.lin_vel), self._float(entity.ang_vel)], -1)
            views.qpos[rows, layout.root_qpos : layout.root_qpos + 7] = pose
            views.qvel[rows, layout.root_qvel : layout.root_qvel + 6] = speed
        elif layout.root == "mocap":
            self._place(layout, entity.pos, entity.rot, rows)
        if len(layout.qpos):
            _put(views.qpos, rows, joints, self._float(entity.joint_pos))
            _put(views.qvel, rows, speeds, self._float(entity.joint_vel))
        if len(layout.ctrl):
            target = entity.joint_target
            if target is None:
                target = layout.held(self._float(entity.joint_pos))
            _put(views.ctrl, rows, targets, self._float(target))

    def _place(self, layout: EntityLayout, pos: object, rot: object, rows: slice | Tensor) -> None:
        views = self._running.views
        views.mocap_pos[rows, layout.mocap] = self._float(pos)
        views.mocap_quat[rows, layout.mocap] = self._float(rot)

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        rows = self.on.rows(env_ids)
        placed = {item.name: item for item in self.layout.objects if item.root == "mocap"}
        with self.on.scope():
            for name, (pos, rot) in poses.items():
                if name not in placed:
                    raise unknown_name("fixed object or marker", name, placed)
                self._place(placed[name], pos, rot, rows)

    @override
    def get_joint_positions(self, robot: str, env_ids: EnvIds = None) -> Tensor:
        return self._running.views.qpos[self.on.rows(env_ids)][:, self._columns[robot][0]].clone()

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        rows, ctrl = self.on.rows(env_ids), self._running.views.ctrl
        with self.on.scope():
            for robot in self.layout.robots:
                if robot.name in targets:
                    columns = self._columns[robot.name][2]
                    target = self._float(targets[robot.name])
                    _put(ctrl, rows, columns, target.clamp(self._low[columns], self._high[columns]))

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        """Advances the environments ``env_ids`` by ``num_steps``; all of them is fastest.

        An environment whose state is no longer finite is put back to the last state that was set, counted
        in :attr:`num_resets` and logged; no other one is touched.

        Raises:
            SimulatorError: if a buffer for contacts or constraints was too small; it names the setting.
        """
        self._step(num_steps, env_ids, None)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        with self.on.scope():
            start = self._running.views.ctrl.clone()
        self.set_joint_targets(targets, env_ids)
        self._step(num_steps, env_ids, start)

    def _step(self, num_steps: int, env_ids: EnvIds, start: Tensor | None) -> None:
        worlds = self._running
        with self.on.scope():
            some = env_ids is not None and len(env_ids) < self.num_envs
            lost = worlds.step(num_steps, self.on.rows(env_ids) if some else None, start)
        if len(lost):
            logger.warning(
                "The state of environments %s was no longer finite: back to where they began. Check the "
                "actions, or give physics.timestep_s a smaller value.",
                lost.tolist(),
            )

    # -- images -----------------------------------------------------------------------------------

    @override
    def snapshot(self, env_ids: EnvIds = None) -> Snapshots:
        views, rows = self._running.views, self.on.rows(env_ids)
        ids = rows_of(env_ids, self.num_envs).tolist()
        with self.on.scope():
            return Snapshots(
                qpos=views.qpos[rows].clone(),
                mocap_pos=views.mocap_pos[rows].clone(),
                mocap_quat=views.mocap_quat[rows].clone(),
                appearances=tuple(self._appearances[env_id] for env_id in ids),
            )

    @override
    def render_jobs(
        self,
        jobs: Sequence[RenderJob],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        if self.renderer_name != _TRACED:
            return super().render_jobs(list(jobs), cameras, modalities)
        images = self.render_tensors(jobs, cameras, modalities)
        return {
            camera: {modality: image.cpu().numpy() for modality, image in kinds.items()}
            for camera, kinds in images.items()
        }

    @override
    def render_tensors(
        self,
        jobs: Sequence[RenderJob] | None = None,
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
        *,
        out: Mapping[str, Mapping[str, Tensor]] | None = None,
    ) -> Images:
        """Draws like :meth:`render_jobs`, and leaves the images on the device.

        Args:
            jobs: Snapshots; every environment as it is now by default.
            cameras: Names of cameras; all of them by default.
            modalities: Of :data:`envs.simulators.base.MODALITIES`.
            out: Camera to modality to the tensor (n, H, W, …) to render into, which may be a part of a larger
                one; new tensors by default.
        """
        if self.renderer_name != _TRACED:
            return super().render_tensors(jobs, cameras, modalities)
        names, kinds = self.checked_names(cameras, modalities)
        shots = Snapshots.of(self.snapshot() if jobs is None else jobs, self.device)
        return self.tracer.draw(
            shots.qpos, shots.mocap_pos, shots.mocap_quat, shots.appearances, names, kinds, out
        )

    @property
    def tracer(self) -> BatchTracer:
        """The ray tracer, made at the first image."""
        if self._tracer is None:
            self._check_open()
            self._tracer = BatchTracer(
                self.model, self.scenario, self.on, self.settings, self.num_envs, self.textures
            )
        return self._tracer

    @property
    @override
    def segmentation_names(self) -> tuple[str, ...]:
        traced = self.renderer_name == _TRACED
        return self.tracer.segmentation_names if traced else super().segmentation_names

    @override
    def close(self) -> None:
        super().close()
        self._tracer = self.worlds = None


def _put(target: Tensor, rows: slice | Tensor, columns: slice | Tensor, values: Tensor) -> None:
    """Writes ``values`` (n, k) to every row and column, whichever of them are slices."""
    if isinstance(rows, Tensor) and isinstance(columns, Tensor):
        rows = rows[:, None]
    target[rows, columns] = values
