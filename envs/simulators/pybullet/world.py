"""One environment in Bullet: a physics client with the scene's trees and static bodies."""

from typing import override

import mujoco
import numpy as np
import pybullet

from envs.core.errors import SimulatorError
from envs.mjcf.collision import touching
from envs.rotations import conjugate, multiply, rotate
from envs.simulators.pybullet.drives import Drives
from envs.simulators.pybullet.settings import PybulletSettings
from envs.simulators.pybullet.trees import Tree, still_geoms
from envs.simulators.translated_handler import World

_GEOM = mujoco.mjtGeom
_FLAGS = (
    pybullet.URDF_USE_INERTIA_FROM_FILE
    | pybullet.URDF_USE_IMPLICIT_CYLINDER
    | pybullet.URDF_USE_SELF_COLLISION
    | pybullet.URDF_ENABLE_CACHED_GRAPHICS_SHAPES
)
_WXYZ, _XYZW = [3, 0, 1, 2], [1, 2, 3, 0]

MAX_SPEED = 1000.0
"""Of a joint, rad/s (m/s): Bullet's own limit of 100 would be a brake."""


class PybulletWorld(World):
    """A physics client of its own, and its dynamic bodies.

    Bullet keeps contacts from step to step, so that the future depends on more than on what can be read or
    set. Where that would show, at the first step after a state was set, the client is rebuilt.

    Args:
        model: The compiled model.
        trees: What was written of it.
        settings: Options of the solver.

    Attributes:
        client: Bullet's physics client.
        drives: Joint motors of the trees that have joints.
    """

    def __init__(self, model: mujoco.MjModel, trees: tuple[Tree, ...], settings: PybulletSettings) -> None:
        self._model, self._trees, self._settings = model, trees, settings
        self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise SimulatorError("PyBullet has no further physics client: it holds 1,024. Take fewer envs.")
        self._given: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._mocap: tuple[np.ndarray, np.ndarray] | None = None
        self._build()

    def _build(self) -> None:
        client, option = self.client, self._model.opt
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=float(option.timestep),
            numSolverIterations=self._settings.iterations,
            numSubSteps=0,
            erp=self._settings.erp,
            contactERP=self._settings.erp,
            deterministicOverlappingPairs=1,
            enableFileCaching=1,
            physicsClientId=client,
        )
        pybullet.setGravity(*option.gravity.tolist(), physicsClientId=client)
        self._still = [_add_still(client, self._model, geom) for geom in still_geoms(self._model)]
        self._parts = [_Part(client, self._model, tree) for tree in self._trees]
        _filter(client, self._model, self._still, self._parts)
        self.drives = [part.drives for part in self._parts if part.drives is not None]
        self._has_stepped = False

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self._given = qpos.astype(np.float64), qvel.astype(np.float64), ctrl.astype(np.float64)

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self._mocap = mocap_pos.astype(np.float64), mocap_quat.astype(np.float64)
        if self._given is None:
            for part in self._parts:
                part.place(*self._mocap)

    def settle(self) -> None:
        """Takes up the state that was put."""
        if self._given is None:
            return
        if self._has_stepped:
            self._build()
        if self._mocap is not None:
            for part in self._parts:
                part.place(*self._mocap)
        qpos, qvel, ctrl = self._given
        for part in self._parts:
            part.put(qpos, qvel)
            if part.drives is not None:
                part.drives.aim(ctrl)
        self._given = None

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        self.settle()
        for drives in self.drives:
            drives.aim(ctrl)

    @override
    def step(self, num_steps: int) -> None:
        self.settle()
        self._has_stepped = True
        client, step = self.client, pybullet.stepSimulation
        for drives in self.drives:
            drives.linearize()
        for _ in range(num_steps):
            for drives in self.drives:
                drives.push()
            step(physicsClientId=client)

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        for part in self._parts:
            part.read(qpos, qvel)

    @override
    def close(self) -> None:
        if self.client >= 0:
            pybullet.disconnect(self.client)
        self.client = -1


class _Part:
    """One tree in Bullet, and its addresses in the model's arrays.

    MuJoCo's velocity is that of the body's origin, in the world, and its rate of turning is in the body's
    frame; Bullet gives pose and velocity of the base's centre of mass and principal axes, in the world.
    """

    def __init__(self, client: int, model: mujoco.MjModel, tree: Tree) -> None:
        self.client, self.tree = client, tree
        flags = _FLAGS | (pybullet.URDF_USE_SELF_COLLISION_INCLUDE_PARENT if tree.touches_own_root else 0)
        self.unique = pybullet.loadURDF(
            str(tree.urdf), useFixedBase=not tree.free, flags=flags, physicsClientId=client
        )
        info = pybullet.getDynamicsInfo(self.unique, -1, physicsClientId=client)
        self._com, self._turn = np.array(info[3]), np.array(info[4])[_WXYZ]
        self._pos, self._rot = slice(tree.qpos, tree.qpos + 3), slice(tree.qpos + 3, tree.qpos + 7)
        self._lin, self._ang = slice(tree.dof, tree.dof + 3), slice(tree.dof + 3, tree.dof + 6)
        count = pybullet.getNumJoints(self.unique, physicsClientId=client)
        names = {info[12].decode(): info[0] for info in self._infos(count)}
        self.links = {link: names.get(link.name, -1) for link in tree.description.links}
        self._set_dynamics(model)
        self.drives = None
        if tree.description.joints:
            self.drives = Drives(pybullet, client, self.unique, model, tree)
        if not tree.free:
            hangs = tree.description.links[0].body == 0
            pose = (np.zeros(3), np.array([1.0, 0, 0, 0])) if hangs else _at_rest(model, tree.body)
            self._put_base(*pose)

    def _infos(self, count: int) -> list[tuple]:
        return [pybullet.getJointInfo(self.unique, i, physicsClientId=self.client) for i in range(count)]

    def _set_dynamics(self, model: mujoco.MjModel) -> None:
        for link, index in self.links.items():
            geoms = [geom for geom in geoms_of(model, link.body) if touches(model, geom)]
            slide, spin = model.geom_friction[geoms, :2].max(0) if geoms else (1.0, 0.0)
            pybullet.changeDynamics(
                self.unique,
                index,
                lateralFriction=float(slide),
                spinningFriction=float(spin),
                rollingFriction=0.0,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                maxJointVelocity=MAX_SPEED,
                physicsClientId=self.client,
            )

    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Takes positions and velocities from the row."""
        if self.tree.free:
            rot = qpos[self._rot]
            self._put_base(qpos[self._pos], rot)
            turning = rotate(rot, qvel[self._ang])
            speed = qvel[self._lin] + np.cross(turning, rotate(rot, self._com))
            pybullet.resetBaseVelocity(
                self.unique, speed.tolist(), turning.tolist(), physicsClientId=self.client
            )
        if self.drives is not None:
            self.drives.put(qpos, qvel)

    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        """Takes the pose from the row, if it is one that is put in place."""
        if self.tree.mocap >= 0:
            self._put_base(mocap_pos[self.tree.mocap], mocap_quat[self.tree.mocap])

    def _put_base(self, pos: np.ndarray, rot: np.ndarray) -> None:
        centre, axes = pos + rotate(rot, self._com), multiply(rot, self._turn)
        pybullet.resetBasePositionAndOrientation(
            self.unique, centre.tolist(), axes[_XYZW].tolist(), physicsClientId=self.client
        )

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes positions and velocities into the row."""
        if self.tree.free:
            centre, axes = pybullet.getBasePositionAndOrientation(self.unique, physicsClientId=self.client)
            lin, ang = pybullet.getBaseVelocity(self.unique, physicsClientId=self.client)
            rot = multiply(np.array(axes)[_WXYZ], conjugate(self._turn))
            arm = rotate(rot, self._com)
            turning = np.array(ang)
            qpos[self._pos], qpos[self._rot] = np.array(centre) - arm, rot
            qvel[self._lin] = np.array(lin) - np.cross(turning, arm)
            qvel[self._ang] = rotate(conjugate(rot), turning)
        if self.drives is not None:
            qpos[self.drives.qpos], qvel[self.drives.dofs] = self.drives.read()


def geoms_of(model: mujoco.MjModel, body: int | None) -> range:
    """Returns the geoms of a body; of none, for the world, whose geoms are no tree's."""
    if not body:
        return range(0)
    first = int(model.body_geomadr[body])
    return range(first, first + int(model.body_geomnum[body]))


def touches(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom touches anything by itself."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _at_rest(model: mujoco.MjModel, body: int) -> tuple[np.ndarray, np.ndarray]:
    return model.body_pos[body].copy(), model.body_quat[body].copy()


def _add_still(client: int, model: mujoco.MjModel, geom: int) -> tuple[int, int]:
    """Adds a geom of the world; returns Bullet's number and the geom."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    given: dict = {"physicsClientId": client}
    if kind == _GEOM.mjGEOM_PLANE:
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=[0, 0, 1], **given)
    elif kind == _GEOM.mjGEOM_BOX:
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=size.tolist(), **given)
    elif kind == _GEOM.mjGEOM_SPHERE:
        shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=float(size[0]), **given)
    elif kind in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE):
        form = pybullet.GEOM_CYLINDER if kind == _GEOM.mjGEOM_CYLINDER else pybullet.GEOM_CAPSULE
        shape = pybullet.createCollisionShape(
            form, radius=float(size[0]), height=2.0 * float(size[1]), **given
        )
    else:
        name = model.geom(geom).name or f"number {geom}"
        raise SimulatorError(
            f"simulator=pybullet has no shape for the geom '{name}' of the world ({_GEOM(kind).name}). "
            "Take simulator=mujoco."
        )
    unique = pybullet.createMultiBody(
        0.0,
        shape,
        basePosition=model.geom_pos[geom].tolist(),
        baseOrientation=model.geom_quat[geom][_XYZW].tolist(),
        **given,
    )
    slide, spin, _ = (float(value) for value in model.geom_friction[geom])
    pybullet.changeDynamics(unique, -1, lateralFriction=slide, spinningFriction=spin, **given)
    return unique, geom


def _filter(client: int, model: mujoco.MjModel, still: list[tuple[int, int]], parts: list[_Part]) -> None:
    """Disables contact pairs that MuJoCo does not have; Bullet enables all by default."""
    solids = [(unique, -1, [geom]) for unique, geom in still]
    for part in parts:
        for link, index in part.links.items():
            geoms = [geom for geom in geoms_of(model, link.body) if touches(model, geom)]
            if geoms:
                solids.append((part.unique, index, geoms))
    if not solids:
        return
    starts = np.cumsum([0, *(len(geoms) for *_, geoms in solids[:-1])])
    touch = touching(model, np.concatenate([geoms for *_, geoms in solids]))
    meet = np.logical_or.reduceat(np.logical_or.reduceat(touch, starts, axis=0), starts, axis=1)
    for number, other in np.argwhere(np.tril(~meet, -1)).tolist():
        (one, index, _), (two, at, _) = solids[number], solids[other]
        pybullet.setCollisionFilterPair(one, two, index, at, 0, physicsClientId=client)
