"""One environment in PhysX: the trees of a scene as rigid bodies and articulations."""

import math
import threading
from collections.abc import Sequence
from typing import override

import mujoco
import numpy as np
import sapien
from sapien import Pose, physx

from envs.mjcf.link_tree import JointSpec, LinkSpec, SceneSpec, TreeSpec
from envs.simulators.sapien.settings import SapienSettings
from envs.simulators.sapien.shapes import ShapeFactory, pose_of
from envs.simulators.translated_handler import World

HOLD = 1e4
"""Velocity gain, N·m·s/rad (N·s/m), of the drive that models dry friction; its force limit is the
friction. Below that force the joint creeps by less than a milliradian per second."""

SOFT_SPEED = 0.05
"""Speed, rad/s (m/s), at which a driven joint has most of its dry friction."""

_BUILDING = threading.Lock()

MAX_SPEED = 1000.0
"""Linear, m/s, and angular, rad/s: PhysX's own limits of 10 and 50 slow down what falls."""


class SapienWorld(World):
    """A physics system of its own, and its dynamic bodies.

    PhysX keeps contacts and their order from step to step, so that the future depends on more than on what
    can be read or set. Where that would show, at the first step after a state was set, the system is made
    anew; setting a state and drawing it costs nothing.

    Args:
        model: The compiled model.
        spec: What was read of it.
        settings: Options of PhysX.
    """

    def __init__(self, model: mujoco.MjModel, spec: SceneSpec, settings: SapienSettings) -> None:
        self._model, self._spec, self._settings = model, spec, settings
        self._mocap: tuple[np.ndarray, np.ndarray] | None = None
        self._put: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._build()

    @property
    def native(self) -> sapien.Scene:
        """SAPIEN's scene, until the world is rebuilt."""
        return self._scene

    def _build(self) -> None:
        with _BUILDING:  # PhysX's options belong to the process, and are read when something is made
            _configure(self._settings, self._model.opt.gravity)
            self._build_scene()
        self._has_stepped = False

    def _build_scene(self) -> None:
        self._scene = sapien.Scene([physx.PhysxCpuSystem()])
        self._system = self._scene.physx_system
        self._system.timestep = self._model.opt.timestep
        shapes = ShapeFactory(self._model)
        if self._spec.still:
            component = physx.PhysxRigidStaticComponent()
            for geom, frame in self._spec.still:
                component.attach(shapes.make(geom, frame, 0))
            _add(self._scene, component, "world", Pose())
        build = _Builder(self._scene, shapes, self._settings)
        self._parts: list[_Part] = []
        for number, tree in enumerate(self._spec.trees, start=1):
            if any(link.geoms for link in tree.links) or tree.root != "mocap" or len(tree.links) > 1:
                self._parts += build.parts(tree, number)
        self._pushing = [part for part in self._parts if part.has_own_force]

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self._put = qpos.copy(), qvel.copy(), ctrl.copy()

    def _settle(self) -> None:
        """Takes up the state that was put."""
        if self._put is None:
            return
        if self._has_stepped:
            self._scene.clear()
            self._build()
        if self._mocap is not None:
            for part in self._parts:
                part.place(*self._mocap)
        qpos, qvel, ctrl = self._put
        for part in self._parts:
            part.put(qpos, qvel)
            part.drive(ctrl)
        self._put = None

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self._mocap = mocap_pos.copy(), mocap_quat.copy()
        if self._put is None:
            for part in self._parts:
                part.place(*self._mocap)

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        self._settle()
        for part in self._parts:
            part.drive(ctrl)

    @override
    def step(self, num_steps: int) -> None:
        self._settle()
        self._has_stepped = True
        step = self._system.step
        if not self._pushing:
            for _ in range(num_steps):
                step()
            return
        for _ in range(num_steps):
            for part in self._pushing:
                part.push()
            step()

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        for part in self._parts:
            part.read(qpos, qvel)

    @override
    def close(self) -> None:
        self._parts = self._pushing = []
        self._scene.clear()


class _Part:
    """A body or an articulation and its addresses in the model's arrays; by itself it does nothing."""

    has_own_force = False

    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Takes its positions and velocities from the row."""

    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        """Takes its pose from the row, if it is one that is put in place."""

    def drive(self, ctrl: np.ndarray) -> None:
        """Takes its targets from the row."""

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Writes its positions and velocities into the row."""

    def push(self) -> None:
        """Applies, for the next step, what PhysX has no passive force for."""


class _Kinematic(_Part):
    """A body that stays where it is put."""

    def __init__(self, entity: sapien.Entity, mocap: int) -> None:
        self._entity, self._mocap = entity, mocap

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None: ...

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self._entity.pose = Pose(mocap_pos[self._mocap], mocap_quat[self._mocap])

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None: ...


class _Free(_Part):
    """A rigid body that moves freely.

    MuJoCo's velocity is that of the body's origin, in the world, and its rate of turning is in the body's
    frame; PhysX's is that of the centre of mass, and its rate of turning is in the world.
    """

    def __init__(self, component: physx.PhysxRigidDynamicComponent, tree: TreeSpec) -> None:
        self._component, self._entity = component, component.entity
        self._qpos = slice(tree.qpos, tree.qpos + 7)
        self._pos, self._rot = slice(tree.qpos, tree.qpos + 3), slice(tree.qpos + 3, tree.qpos + 7)
        self._lin, self._ang = slice(tree.dof, tree.dof + 3), slice(tree.dof + 3, tree.dof + 6)
        inertia = tree.links[0].inertia
        centre = np.zeros(3) if inertia is None else inertia.frame[0]
        self._centre = centre if np.abs(centre).max() > 1e-9 else None

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        pose = Pose(qpos[self._pos], qpos[self._rot])
        lin, ang = _to_physx(qpos[self._rot], qvel[self._lin], qvel[self._ang], self._centre)
        self._entity.pose = pose
        self._component.linear_velocity, self._component.angular_velocity = lin, ang

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        pose, component = self._entity.pose, self._component
        rot = pose.q
        qpos[self._pos], qpos[self._rot] = pose.p, rot
        lin, ang = component.linear_velocity, component.angular_velocity
        qvel[self._lin], qvel[self._ang] = _from_physx(rot, lin, ang, self._centre)


class _Articulation(_Part):
    """Links and joints; the root moves freely, is put in place, or never moves."""

    def __init__(self, articulation: physx.PhysxArticulation, tree: TreeSpec) -> None:
        self._articulation, self._tree = articulation, tree
        specs = {link.joint.name: link.joint for link in tree.links if link.joint is not None}
        joints = articulation.get_active_joints()
        order = [specs[joint.name] for joint in joints]
        self._qpos = np.array([spec.qpos for spec in order], np.intp)
        self._dofs = np.array([spec.dof for spec in order], np.intp)
        drives = [
            (joint.set_drive_target, spec.actuator)
            for joint, spec in zip(joints, order, strict=True)
            if spec.actuator >= 0 and not spec.takes_force
        ]
        self._setters = [set_target for set_target, _ in drives]
        self._last = [math.nan] * len(drives)
        self._ctrl = np.array([actuator for _, actuator in drives], np.intp)
        self._pushed = np.array([spec.takes_force for spec in order], bool)
        self._pusher = np.array([spec.actuator for spec in order if spec.takes_force], np.intp)
        self._force = np.zeros(len(order))
        rubs = np.array([spec.friction > 0.0 for spec in order])
        driven = np.array([spec.actuator >= 0 for spec in order], bool)
        self._stiffness = np.where(rubs & ~driven, [spec.stiffness for spec in order], 0.0)
        self._damping = np.where(rubs & ~driven, [spec.damping for spec in order], 0.0)
        self._friction = np.where(rubs & driven, [spec.friction for spec in order], 0.0)
        self._rest = np.array([spec.rest for spec in order])
        self._servos = _Servos(order) if tree.root == "free" else None
        passive = (self._stiffness, self._damping, self._friction)
        self.has_own_force = bool(self._servos) or any(np.any(a) for a in (*passive, self._pushed))
        inertia = tree.links[0].inertia
        self._centre = None if inertia is None else inertia.frame[0]
        self._pos, self._rot = slice(tree.qpos, tree.qpos + 3), slice(tree.qpos + 3, tree.qpos + 7)
        self._lin, self._ang = slice(tree.dof, tree.dof + 3), slice(tree.dof + 3, tree.dof + 6)

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        articulation = self._articulation
        if self._tree.root == "free":
            articulation.set_root_pose(Pose(qpos[self._pos], qpos[self._rot]))
            lin, ang = _to_physx(qpos[self._rot], qvel[self._lin], qvel[self._ang], self._centre)
            articulation.set_root_linear_velocity(lin)
            articulation.set_root_angular_velocity(ang)
        articulation.set_qpos(qpos[self._qpos])
        articulation.set_qvel(qvel[self._dofs])
        articulation.set_qf(np.zeros(len(self._dofs), np.float32))
        articulation.set_qacc(np.zeros(len(self._dofs), np.float32))

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        if self._tree.root == "mocap":
            pose = Pose(mocap_pos[self._tree.mocap], mocap_quat[self._tree.mocap])
            self._articulation.set_root_pose(pose)

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        targets = ctrl[self._ctrl].tolist()
        for set_target, target, last in zip(self._setters, targets, self._last, strict=True):
            if target != last:
                set_target(target)
        self._last = targets
        self._force[self._pushed] = ctrl[self._pusher]
        if self._servos:
            self._servos.aim(ctrl)

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        articulation = self._articulation
        qpos[self._qpos], qvel[self._dofs] = articulation.get_qpos(), articulation.get_qvel()
        if self._tree.root == "free":
            pose = articulation.get_root_pose()
            qpos[self._pos], qpos[self._rot] = pose.p, pose.q
            lin, ang = articulation.get_root_linear_velocity(), articulation.get_root_angular_velocity()
            qvel[self._lin], qvel[self._ang] = _from_physx(pose.q, lin, ang, self._centre)

    @override
    def push(self) -> None:
        articulation = self._articulation
        qpos, qvel = articulation.get_qpos(), articulation.get_qvel()
        force = self._force - self._stiffness * (qpos - self._rest) - self._damping * qvel
        force -= self._friction * np.tanh(qvel / SOFT_SPEED)
        if self._servos:
            force += self._servos.missing(qpos, qvel)
        articulation.set_qf(force.astype(np.float32))


class _Servos:
    """Difference of PhysX's drives from position actuators with separate joint damping.

    A joint has one drive in PhysX, and its limit bounds the damping too; in MuJoCo the limit bounds the
    actuator, and the damping is added. The two are the same until an actuator reaches its limit, as those of
    a robot on legs often do: at 10 rad/s the H1's damping is a quarter of its ankles' limit and half of its
    elbows'. Where the base is fixed this is left out, for it costs some microseconds a step and changes
    little: at 1 rad/s a Franka's damping is 1 % of its wrist's limit.

    Args:
        joints: Joints in the articulation's order.
    """

    def __init__(self, joints: Sequence[JointSpec]) -> None:
        driven = np.array([spec.actuator >= 0 and not spec.takes_force for spec in joints], bool)
        self._driven = driven
        self._kp, self._kd, self._damping = (
            np.where(driven, [getattr(spec, name) for spec in joints], 0.0)
            for name in ("kp", "kd", "damping")
        )
        self._limit = np.array([spec.force_limit for spec in joints])
        self._actuators = np.array([spec.actuator for spec in joints], np.intp)[driven]
        self._target = np.zeros(len(joints))
        self._bounded = bool(np.any(np.isfinite(self._limit) & (self._damping > 0.0)))

    def __bool__(self) -> bool:
        return self._bounded

    def aim(self, ctrl: np.ndarray) -> None:
        """Takes the targets from the row."""
        self._target[self._driven] = ctrl[self._actuators]

    def missing(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Returns the forces to add to the drives', (J,)."""
        force, drag = self._kp * (self._target - qpos) - self._kd * qvel, self._damping * qvel
        low, high = -self._limit, self._limit
        return _bounded(force, low, high) - drag - _bounded(force - drag, low, high)


def _bounded(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(value, low), high)  # 2× faster than np.clip


def _to_physx(rot: np.ndarray, lin: np.ndarray, ang: np.ndarray, centre: np.ndarray | None) -> tuple:
    turning = _turned(rot.tolist(), ang.tolist())
    speed = lin.astype(np.float64)
    if centre is not None:
        speed = speed + np.cross(turning, _turned(rot.tolist(), centre.tolist()))
    return speed.astype(np.float32), np.array(turning, np.float32)


def _from_physx(rot: np.ndarray, lin: np.ndarray, ang: np.ndarray, centre: np.ndarray | None) -> tuple:
    turn = w, x, y, z = rot.tolist()
    if centre is not None:
        lin = lin - np.cross(ang.astype(np.float64), _turned(turn, centre.tolist()))
    return lin, _turned((w, -x, -y, -z), ang.tolist())


def _turned(rot: Sequence[float], vector: Sequence[float]) -> tuple[float, float, float]:
    """Returns a vector (3,) turned by a quaternion (4,): three numbers are not worth an array."""
    (w, x, y, z), (a, b, c) = rot, vector
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + w * p + y * r - z * q,
        b + w * q + z * p - x * r,
        c + w * r + x * q - y * p,
    )


class _Builder:
    """Makes parts of trees."""

    def __init__(self, scene: sapien.Scene, shapes: ShapeFactory, settings: SapienSettings) -> None:
        self._scene, self._shapes = scene, shapes
        self._iterations = settings.position_iterations, settings.velocity_iterations

    def parts(self, tree: TreeSpec, number: int) -> list[_Part]:
        """Makes what a tree consists of."""
        root = tree.links[0]
        if len(tree.links) == 1:
            return [self._body(tree, root, number)]
        parts: list[_Part] = []
        apart = tree.touches_own_root and tree.root == "mocap"
        if apart:  # PhysX keeps a link from touching its parent, so the root's shapes are a body of its own
            parts.append(self._body(tree, root, number))
        return [*parts, self._articulation(tree, number, bare_root=apart)]

    def _body(self, tree: TreeSpec, link: LinkSpec, number: int) -> _Part:
        component = physx.PhysxRigidDynamicComponent()
        self._furnish(component, link, number)
        component.kinematic = tree.root != "free"
        entity = _add(self._scene, component, link.name, pose_of(tree.pose))
        if tree.root != "free":
            return _Kinematic(entity, tree.mocap)
        component.solver_position_iterations, component.solver_velocity_iterations = self._iterations
        component.sleep_threshold = 0.0
        return _Free(component, tree)

    def _articulation(self, tree: TreeSpec, number: int, *, bare_root: bool) -> _Part:
        components: list[physx.PhysxArticulationLinkComponent] = []
        entities: list[sapien.Entity] = []  # a component does not keep its entity alive
        for link in tree.links:
            parent = components[link.parent] if link.parent >= 0 else None
            component = physx.PhysxArticulationLinkComponent(parent)
            self._furnish(component, link, number, bare=bare_root and parent is None)
            entity = sapien.Entity()
            entity.add_component(component)
            entity.name = component.name = link.name
            if link.joint is not None:
                _set_joint(component.joint, link.joint)
            components.append(component)
            entities.append(entity)
        components[0].joint.type = "undefined" if tree.root == "free" else "fixed"
        entities[0].pose = pose_of(tree.pose)
        for entity in entities:
            self._scene.add_entity(entity)
        articulation = components[0].articulation
        articulation.solver_position_iterations, articulation.solver_velocity_iterations = self._iterations
        articulation.sleep_threshold = 0.0
        return _Articulation(articulation, tree)

    def _furnish(self, component, link: LinkSpec, number: int, *, bare: bool = False) -> None:
        for geom, frame in () if bare else link.geoms:
            component.attach(self._shapes.make(geom, frame, number))
        if link.inertia is None:  # a root that never moves; PhysX needs a number
            component.mass, component.inertia = 1.0, np.ones(3, np.float32)
            component.cmass_local_pose = Pose()
        else:
            component.mass = link.inertia.mass
            component.inertia = link.inertia.moments.astype(np.float32)
            component.cmass_local_pose = pose_of(link.inertia.frame)
        component.linear_damping = component.angular_damping = 0.0
        component.max_linear_velocity = component.max_angular_velocity = MAX_SPEED
        component.disable_gravity = link.weightless


def _set_joint(joint: physx.PhysxArticulationJoint, spec: JointSpec) -> None:
    joint.name = spec.name
    joint.type = "prismatic" if spec.kind == "slide" else "revolute_unwrapped"
    joint.pose_in_parent, joint.pose_in_child = pose_of(spec.in_parent), pose_of(spec.in_child)
    joint.limit = np.array([spec.limits], np.float32)
    joint.friction = 0.0
    joint.max_velocity = MAX_SPEED
    joint.set_armature(np.array([spec.armature], np.float32))
    if spec.actuator >= 0:
        limit = 3e38 if spec.takes_force else min(spec.force_limit, 3e38)
        joint.set_drive_properties(spec.kp, spec.kd + spec.damping, limit, "force")
    elif spec.friction > 0.0:
        joint.set_drive_properties(0.0, HOLD, spec.friction, "force")
    else:
        joint.set_drive_properties(spec.stiffness, spec.damping, 3e38, "force")
        joint.set_drive_target(spec.rest)


def _add(scene: sapien.Scene, component, name: str, pose: Pose) -> sapien.Entity:
    entity = sapien.Entity()
    entity.add_component(component)
    entity.name = name
    entity.pose = pose
    scene.add_entity(entity)
    return entity


def _configure(settings: SapienSettings, gravity: np.ndarray) -> None:
    """Sets PhysX's options for the scenes and shapes that this process makes from now on."""
    physx.set_scene_config(
        gravity=np.asarray(gravity, np.float32),
        bounce_threshold=settings.bounce_threshold,
        enable_enhanced_determinism=True,
    )
    physx.set_shape_config(contact_offset=settings.contact_offset_m, rest_offset=0.0)
