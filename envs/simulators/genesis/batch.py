"""N environments as one batch of a Genesis scene, and their addresses in its arrays.

Genesis steps all environments of a batch together. Everything that a step reads of the step before, warm
starts and contacts among it, is in arrays with one column for each environment: a column is put back where
an environment was not to be stepped, and made as it was at the start where a state is set.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.mjcf.collision import touching
from envs.mjcf.layout import as_slice, block
from envs.mjcf.link_tree import JointSpec, SceneSpec, TreeSpec, compose
from envs.simulators.genesis.process import end, forget, part, start
from envs.simulators.genesis.settings import INTEGRATORS, GenesisSettings
from envs.simulators.genesis.trees import Text, joint_name, write_still, write_tree


@dataclass(frozen=True, slots=True)
class _Base:
    """A root that moves freely, or stays where it is put.

    Attributes:
        link: Genesis's index of the link that is put in place.
        q: Genesis's address of the pose of one that moves freely.
        dof: Genesis's address of its velocity.
        tree: What it carries.
    """

    link: int
    q: int
    dof: int
    tree: TreeSpec


@dataclass(frozen=True, slots=True)
class Drives:
    """Indices of the driven joints of some environments in Genesis's arrays.

    Attributes:
        q: Index of their positions.
        dof: Index of their velocities, targets, forces and modes.
    """

    q: tuple
    dof: tuple


class Batch:
    """A scene with ``num_envs`` environments.

    Args:
        model: The compiled model.
        spec: What was read of it.
        settings: Options of the solver.
        num_envs: Number of environments.

    Raises:
        SimulatorError: if Genesis has no shape for a geom, or gravity acts on some links of a tree alone.
    """

    def __init__(
        self, model: mujoco.MjModel, spec: SceneSpec, settings: GenesisSettings, num_envs: int
    ) -> None:
        self._gs = gs = start()
        self._model, self.num_envs = model, num_envs
        self._bases: list[_Base] = []
        self._joints: list[tuple[int, int, JointSpec]] = []
        self._added: list[tuple[Any, Text]] = []
        self._solver: Any = None
        self._closed = False
        self._scene = gs.Scene(
            show_viewer=False,
            sim_options=gs.options.SimOptions(
                dt=float(model.opt.timestep), gravity=tuple(model.opt.gravity.tolist())
            ),
            rigid_options=gs.options.RigidOptions(
                integrator=getattr(gs.integrator, INTEGRATORS[settings.integrator]),
                friction_cone=getattr(gs.friction_cone, settings.cone),
                impratio=settings.impratio,
                iterations=settings.iterations,
                tolerance=settings.tolerance,
                max_collision_pairs=settings.max_pairs,
                enable_mujoco_compatibility=True,
                enable_adjacent_collision=True,
                enable_neutral_collision=True,
                enable_torsional_friction=bool((model.geom_condim >= 4).any()),
                enable_rolling_friction=bool((model.geom_condim >= 6).any()),
                constraint_timeconst=None,
            ),
        )
        try:
            self._build(spec)
        except gs.GenesisException as error:
            self.close()
            raise SimulatorError(f"Genesis does not build this scene: {error}") from error
        except SimulatorError:
            self.close()
            raise

    # -- building -----------------------------------------------------------------------------------

    def _build(self, spec: SceneSpec) -> None:
        still = list(spec.still)
        added: list[tuple[Any, TreeSpec]] = []
        for tree in spec.trees:
            if tree.root == "mocap" and len(tree.links) == 1 and not tree.links[0].geoms:
                continue  # only seen
            bare = False
            if tree.root == "fixed":  # in MuJoCo, links touch what is part of the world
                still += [(geom, compose(tree.pose, frame)) for geom, frame in tree.links[0].geoms]
                bare = True
            elif tree.touches_own_root and tree.root == "mocap" and len(tree.links) > 1:
                added.append((self._add(write_tree(self._model, tree, bare_root=False, whole=False)), tree))
                bare = True
            if tree.root == "fixed" and len(tree.links) == 1:
                continue
            text = write_tree(self._model, tree, bare_root=bare)
            added.append((self._add(text, weightless=_weightless(tree)), tree))
        if still:
            self._add(write_still(self._model, still))
        if not added and not still:
            raise SimulatorError("There is nothing in this scene that Genesis could simulate.")
        self._scene.build(n_envs=self.num_envs)
        self._solver = self._scene.sim.rigid_solver
        for entity, tree in added:
            self._find(entity, tree)
        self._keep_apart()
        self._take_arrays()

    def _add(self, text: Text, *, weightless: bool = False) -> Any:
        gs = self._gs
        entity = self._scene.add_entity(
            gs.morphs.MJCF(
                file=text.mjcf,
                convexify=True,
                decimate=False,
                decompose_object_error_threshold=float("inf"),
                decompose_robot_error_threshold=float("inf"),
                default_armature=None,
                align=False,
                batch_fixed_verts=True,
            ),
            material=gs.materials.Rigid(gravity_compensation=1.0 if weightless else 0.0),
        )
        self._added.append((entity, text))
        return entity

    def _find(self, entity: Any, tree: TreeSpec) -> None:
        """Notes where a tree's joints are in Genesis's arrays."""
        found = {joint.name: joint for joint in entity.joints if joint.n_dofs}
        first = entity.links[0]
        free = found.get("free")
        q, dof = (-1, -1) if free is None else (free.q_start, free.dof_start)
        if tree.root != "fixed":
            self._bases.append(_Base(first.idx, q, dof, tree))
        for link in tree.links[1:]:
            assert link.joint is not None, "only the root of a tree has no joint"
            joint = found.get(joint_name(link.joint))
            if joint is not None:  # of a root that is an entity of its own, there are none
                self._joints.append((joint.q_start, joint.dof_start, link.joint))

    def _keep_apart(self) -> None:
        """Enables only the contact pairs that MuJoCo has."""
        geoms = np.zeros(len(self._solver.geoms), np.intp)
        for entity, text in self._added:
            for link in entity.links:
                for geom, number in zip(link.geoms, text.geoms.get(link.name, ()), strict=True):
                    geoms[geom.idx] = number
        if not len(geoms):
            return
        pairs = self._solver.collider.collider_info.collision_pair_idx
        allowed = pairs.to_numpy()
        touch = np.triu(touching(self._model, geoms), 1)
        fixed = np.array([geom.link.is_fixed for geom in self._solver.geoms])
        lost = np.argwhere(touch & (allowed < 0) & ~(fixed[:, None] & fixed))
        if len(lost):
            one, other = (self._model.geom(int(geoms[index])).name for index in lost[0])
            raise SimulatorError(
                f"Genesis lets '{one}' and '{other}' not touch each other. Take simulator=mujoco."
            )
        pairs.from_numpy(np.where(touch, allowed, -1).astype(allowed.dtype))

    def _take_arrays(self) -> None:
        """Finds the columns of environments in Genesis's arrays, as views, and keeps those of the start."""
        array_class, data_to_array = part("utils.array_class"), part("utils.misc").data_to_array
        kinds, solver = (array_class.DataKind.STATE, array_class.DataKind.DERIVED), self._solver
        driven = [(dof, spec.actuator) for _, dof, spec in self._joints if spec.actuator >= 0]
        self._driven = np.array([dof for dof, _ in driven], np.intp)
        self._actuators = np.array([actuator for _, actuator in driven], np.intp)
        specs = [spec for *_, spec in self._joints if spec.actuator >= 0]
        self._driven_q = np.array([q for q, _, spec in self._joints if spec.actuator >= 0], np.intp)
        self._kp, self._kd, self._limit = (
            np.array([getattr(spec, name) for spec in specs])[:, None] for name in ("kp", "kd", "force_limit")
        )
        if driven:
            solver.control_dofs_position(np.zeros((self.num_envs, len(driven))), self._driven)
        self._columns: list[np.ndarray] = []
        for item in solver.data:
            if not isinstance(item, array_class.ArrayItem) or item.kind not in kinds:
                continue
            shape = tuple(item.array.shape)
            if shape and shape[-1] == self.num_envs:
                view = data_to_array(item.array, to_torch=True, copy=False).numpy()
                self._columns.append(np.moveaxis(view, len(shape) - 1, 0))
        self._fresh = [column[0].copy() for column in self._columns]

        def view_of(array: Any) -> np.ndarray:
            return data_to_array(array, to_torch=True, copy=False).numpy()

        self._qpos, self._qvel = view_of(solver.rigid_info.qpos), view_of(solver.dyn_state.dofs.vel)
        dofs = solver.dyn_state.dofs
        self._targets, self._forces = view_of(dofs.ctrl_pos), view_of(dofs.ctrl_force)
        self._modes = view_of(dofs.ctrl_mode)
        self._rows = self._scene._envs_idx
        links = solver.dyn_state.links
        self._link_pos, self._link_quat = view_of(links.pos), view_of(links.quat)
        self._q = np.array([q for q, _, _ in self._joints], np.intp)
        self._dof = np.array([dof for _, dof, _ in self._joints], np.intp)
        self._mujoco_q = np.array([spec.qpos for *_, spec in self._joints], np.intp)
        self._mujoco_dof = np.array([spec.dof for *_, spec in self._joints], np.intp)

    # -- one environment ----------------------------------------------------------------------------

    def put(self, row: int, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        """Sets joints and free bodies of an environment from MuJoCo's arrays, and resets warm-start state."""
        placed = [base.link for base in self._bases if base.tree.root == "mocap"]
        pos, quat = self._link_pos[placed, row].copy(), self._link_quat[placed, row].copy()
        for column, fresh in zip(self._columns, self._fresh, strict=True):
            column[row] = fresh
        self._qpos[self._q, row] = qpos[self._mujoco_q]
        self._qvel[self._dof, row] = qvel[self._mujoco_dof]
        for base in self._bases:
            tree = base.tree
            if tree.root == "free":
                self._qpos[base.q : base.q + 7, row] = qpos[tree.qpos : tree.qpos + 7]
                self._qvel[base.dof : base.dof + 6, row] = qvel[tree.dof : tree.dof + 6]
        self._link_pos[placed, row], self._link_quat[placed, row] = pos, quat
        self.drive(row, ctrl)
        self._move_shapes(row)

    def place(self, row: int, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        """Sets the poses of mocap bodies."""
        for base in self._bases:
            if base.tree.root == "mocap":
                self._link_pos[base.link, row] = mocap_pos[base.tree.mocap]
                self._link_quat[base.link, row] = mocap_quat[base.tree.mocap]
        self._move_shapes(row)

    def drive(self, row: int, ctrl: np.ndarray) -> None:
        """Sets the targets of the driven joints."""
        self._targets[self._driven, row] = ctrl[self._actuators]

    def read(self, row: int, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes positions and velocities into MuJoCo's arrays."""
        qpos[self._mujoco_q], qvel[self._mujoco_dof] = self._qpos[self._q, row], self._qvel[self._dof, row]
        for base in self._bases:
            tree = base.tree
            if tree.root == "free":
                qpos[tree.qpos : tree.qpos + 7] = self._qpos[base.q : base.q + 7, row]
                qvel[tree.dof : tree.dof + 6] = self._qvel[base.dof : base.dof + 6, row]

    def _move_shapes(self, row: int) -> None:
        """Moves the shapes of mocap bodies with them; a step only moves the shapes of dynamic bodies."""
        solver = self._solver
        if any(base.tree.root == "mocap" for base in self._bases):
            part("engine.solvers.rigid.rigid_solver").kernel_forward_kinematics_links_geoms(
                self._rows[row : row + 1],
                solver.dyn_state,
                solver.dyn_info,
                solver.rigid_info,
                solver.rigid_config,
            )
        self._outdate()

    def _outdate(self) -> None:
        self._solver._is_forward_pos_updated = self._solver._is_forward_vel_updated = False

    # -- time ---------------------------------------------------------------------------------------

    def step(
        self, rows: Sequence[int] | np.ndarray, start: np.ndarray, end: np.ndarray, num_steps: int
    ) -> None:
        """Advances environments while their targets move evenly; the others stay as they are.

        Args:
            rows: Environments.
            start: Their targets before the first step, (n, nu).
            end: Their targets in the last step, (n, nu).
            num_steps: Physics steps.

        Raises:
            SimulatorError: if Genesis cannot continue.
        """
        moving = np.asarray(rows, np.intp)
        drives = self.drives_of(moving)
        others = np.setdiff1d(np.arange(self.num_envs), moving)
        kept = [column[others].copy() for column in self._columns] if len(others) else []
        first, last = (values[:, self._actuators].T for values in (start, end))
        way = last - first
        try:
            for index in range(1, num_steps + 1):
                self.aim(drives, first + way * np.float32(index / num_steps))
                self._scene.step(update_visualizer=False, refresh_visualizer=False)
            self._check(moving)
        except self._gs.GenesisException as error:
            raise SimulatorError(f"Genesis stopped: {error}") from error
        finally:
            for column, values in zip(self._columns, kept, strict=len(others) > 0):
                column[others] = values
            if len(others):
                self._outdate()

    def _check(self, rows: np.ndarray) -> None:
        """Checks Genesis's errors of a step at once; by itself it reports them some steps later."""
        failed = self._solver.get_error_envs_mask().numpy()[rows]
        if failed.any():
            try:
                self._solver.check_errno()
            except self._gs.GenesisException as error:
                bad = rows[failed].tolist()
                raise SimulatorError(f"Genesis cannot continue environments {bad}: {error}") from error

    def drives_of(self, rows: np.ndarray) -> Drives:
        """Finds the driven joints of environments (A,)."""
        columns = as_slice(rows)
        return Drives(block(as_slice(self._driven_q), columns), block(as_slice(self._driven), columns))

    def aim(self, drives: Drives, targets: np.ndarray) -> None:
        """Sets targets (n, A), and a force where an actuator gives all that it has.

        Genesis integrates the damping of a position drive implicitly even while its force is at the limit,
        where the force does not depend on the velocity; MuJoCo does not. The joint would be slowed down.
        """
        if not len(self._driven):
            return
        dofs, limit = drives.dof, self._limit
        wanted = self._kp * (targets - self._qpos[drives.q]) - self._kd * self._qvel[dofs]
        given = np.minimum(np.maximum(wanted, -limit), limit)  # 3× faster than np.clip
        self._targets[dofs] = targets
        self._forces[dofs] = given
        modes = self._gs.CTRL_MODE
        self._modes[dofs] = np.where(np.abs(wanted) >= limit, int(modes.FORCE), int(modes.POSITION))

    def close(self) -> None:
        """Frees the scene."""
        if self._closed:
            return
        self._closed = True
        self._columns, self._bases, self._joints, self._added = [], [], [], []
        if self._solver is not None:
            forget(self._solver.dyn_state)
            self._solver = None
        self._scene.destroy()
        end()


def _weightless(tree: TreeSpec) -> bool:
    """Whether gravity acts on none of a tree's links.

    Raises:
        SimulatorError: if it acts on some.
    """
    heavy = {link.weightless for link in tree.links if link.inertia is not None and link.body > 0}
    if len(heavy) > 1:
        name = tree.links[0].name
        raise SimulatorError(
            f"Genesis takes gravity off all links of '{name}' or off none. Take simulator=mujoco."
        )
    return heavy == {True}
