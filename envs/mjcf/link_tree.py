"""A compiled MuJoCo model as trees of rigid links, from which other simulators build their scenes.

Bodies without a joint between them are one link, with their combined mass, centre of mass and inertia. The
frame of a link is that of its uppermost body. A body with several joints becomes a chain of links, all but
the last of them nearly massless. :mod:`envs.convert.description` keeps every body instead, with its
appearance, for files.
"""

from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.rotations import conjugate, multiply, rotate, to_matrix

Frame = tuple[np.ndarray, np.ndarray]
"""Position (3,) and orientation (4,), wxyz."""

SLIGHT_MASS_KG, SLIGHT_INERTIA = 1e-3, 1e-6
"""Of a link between two joints of one body."""

_FREE, _BALL, _SLIDE, _HINGE = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_HINGE,
    )
)


@dataclass(frozen=True, slots=True, eq=False)
class Inertia:
    """Mass and inertia of a link.

    Attributes:
        mass: kg.
        com: Centre of mass in the link, m, (3,).
        rot: Orientation of the principal axes in the link, wxyz, (4,).
        moments: Principal moments of inertia about the centre of mass, kg·m², (3,).
    """

    mass: float
    com: np.ndarray
    rot: np.ndarray
    moments: np.ndarray

    @property
    def frame(self) -> Frame:
        """Centre of mass and orientation of the principal axes."""
        return self.com, self.rot


@dataclass(frozen=True, slots=True)
class JointSpec:
    """A joint with the x axis as its axis.

    Attributes:
        name: Its name in the model.
        kind: ``hinge`` or ``slide``.
        qpos: Address in qpos.
        dof: Address in qvel.
        in_parent: Its frame in the parent link.
        in_child: Its frame in its own link.
        limits: Least and largest position.
        stiffness: Passive spring.
        rest: Where the spring is at rest.
        damping: Passive damping.
        friction: Dry friction, N·m (N).
        armature: Added inertia.
        actuator: Index of the actuator, or -1.
        kp: Position gain of the actuator.
        kd: Its velocity gain.
        force_limit: Its largest force.
        takes_force: Its target is a force, N·m (N), not a position.
    """

    name: str
    kind: Literal["hinge", "slide"]
    qpos: int
    dof: int
    in_parent: Frame
    in_child: Frame
    limits: tuple[float, float]
    stiffness: float
    rest: float
    damping: float
    friction: float
    armature: float
    actuator: int = -1
    kp: float = 0.0
    kd: float = 0.0
    force_limit: float = np.inf
    takes_force: bool = False


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A rigid part.

    Attributes:
        body: Its uppermost body.
        name: That body's name.
        parent: Index of its parent in the tree, or -1 for the root.
        joint: How it moves against its parent; None for the root.
        inertia: Mass and inertia, or None if it has none.
        geoms: Ids of the geoms that touch something, and their frames in the link.
        weightless: Gravity does not act on it.
    """

    body: int
    name: str
    parent: int
    joint: JointSpec | None
    inertia: Inertia | None
    geoms: tuple[tuple[int, Frame], ...]
    weightless: bool


@dataclass(frozen=True, slots=True)
class TreeSpec:
    """Links that are jointed to one another.

    Attributes:
        root: How the first link moves: freely, wherever it is put, or never.
        pose: Where it is at first.
        qpos: Address of the free joint in qpos, or -1.
        dof: Address of the free joint in qvel, or -1.
        mocap: Index of what is put in place, or -1.
        links: Parents before children.
        touches_own_root: Links touch the root that they are jointed to.
    """

    root: Literal["free", "mocap", "fixed"]
    pose: Frame
    qpos: int
    dof: int
    mocap: int
    links: tuple[LinkSpec, ...]
    touches_own_root: bool = False


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """The static geoms of a scene, and the trees that move.

    Attributes:
        still: Ids of the geoms of the world that touch something, and their frames in it.
        trees: What moves.
    """

    still: tuple[tuple[int, Frame], ...]
    trees: tuple[TreeSpec, ...] = field(default=())


def describe(model: mujoco.MjModel, simulator: str) -> SceneSpec:
    """Reads a compiled model.

    Args:
        model: The scene.
        simulator: Name of the simulator, for messages.

    Raises:
        SimulatorError: if it has a ball joint, an equality constraint, or an actuator that is not one of a
            joint's position.
    """
    _check(model, simulator)
    heads = _heads(model)
    frames = _frames_in(model, heads)
    of_head: dict[int, list[int]] = {}
    for body in range(model.nbody):
        of_head.setdefault(int(heads[body]), []).append(body)
    roots = [head for head in of_head if head and heads[model.body_parentid[head]] == 0]
    trees = []
    for root in roots:
        members = [head for head in of_head if head and _root_of(model, heads, head) == root]
        trees.append(_tree(model, root, sorted(members), of_head, heads, frames))
    return SceneSpec(_geoms(model, of_head[0], frames), tuple(trees))


def _check(model: mujoco.MjModel, simulator: str) -> None:
    for joint in range(model.njnt):
        if model.jnt_type[joint] == _BALL:
            raise SimulatorError(
                f"simulator={simulator} has no ball joint such as '{model.joint(joint).name}'. Take "
                "simulator=mujoco, or give the body three hinges."
            )
    if model.neq:
        first, second = tied(model)
        raise SimulatorError(
            f"simulator={simulator} has no equality constraint such as that of '{first}' and '{second}'. "
            "Take simulator=mujoco."
        )
    for index in range(model.nu):
        position = model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
        if model.actuator_trntype[index] != mujoco.mjtTrn.mjTRN_JOINT or not position:
            raise SimulatorError(
                f"The actuator '{model.actuator(index).name}' does not drive a joint to a position, which is "
                f"all that simulator={simulator} does. Take simulator=mujoco."
            )


def tied(model: mujoco.MjModel) -> tuple[str, str]:
    """Returns the names of what the first equality constraint of a model ties together."""
    accessor = model.body
    if model.eq_type[0] == mujoco.mjtEq.mjEQ_JOINT:
        accessor = model.joint
    elif model.eq_type[0] == mujoco.mjtEq.mjEQ_TENDON:
        accessor = model.tendon
    elif model.eq_objtype[0] == mujoco.mjtObj.mjOBJ_SITE:
        accessor = model.site
    first, second = (int(ids[0]) for ids in (model.eq_obj1id, model.eq_obj2id))
    return accessor(first).name, accessor(second).name if second >= 0 else "a constant"


def _heads(model: mujoco.MjModel) -> np.ndarray:
    """Returns, for each body, the uppermost body that it cannot move against; 0 for what never moves."""
    moves = np.asarray(model.body_jntnum) > 0
    carries = moves.copy()
    for body in range(model.nbody - 1, 0, -1):
        carries[model.body_parentid[body]] |= carries[body]
    heads = np.zeros(model.nbody, np.intp)
    for body in range(1, model.nbody):
        parent = model.body_parentid[body]
        own = moves[body] or model.body_mocapid[body] >= 0 or (parent == 0 and carries[body])
        heads[body] = body if own else heads[parent]
    return heads


def _root_of(model: mujoco.MjModel, heads: np.ndarray, head: int) -> int:
    while heads[model.body_parentid[head]] != 0:
        head = int(heads[model.body_parentid[head]])
    return head


def _frames_in(model: mujoco.MjModel, heads: np.ndarray) -> list[Frame]:
    """Returns the frame of each body in its head."""
    frames: list[Frame] = []
    for body in range(model.nbody):
        if heads[body] == body:
            frames.append((np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        else:
            own = (np.array(model.body_pos[body]), np.array(model.body_quat[body]))
            frames.append(compose(frames[model.body_parentid[body]], own))
    return frames


def _geoms(model: mujoco.MjModel, bodies: list[int], frames: list[Frame]) -> tuple[tuple[int, Frame], ...]:
    out = []
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    for body in bodies:
        first = model.body_geomadr[body]
        for geom in range(first, first + model.body_geomnum[body]):
            if model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired:
                own = (np.array(model.geom_pos[geom]), np.array(model.geom_quat[geom]))
                out.append((geom, compose(frames[body], own)))
    return tuple(out)


def _tree(
    model: mujoco.MjModel,
    root: int,
    members: list[int],
    of_head: dict[int, list[int]],
    heads: np.ndarray,
    frames: list[Frame],
) -> TreeSpec:
    links: list[LinkSpec] = []
    last: dict[int, int] = {}
    first_joint = int(model.body_jntadr[root])
    free = first_joint >= 0 and model.jnt_type[first_joint] == _FREE
    mocap = int(model.body_mocapid[root])
    pose = (np.array(model.body_pos[root]), np.array(model.body_quat[root]))
    if first_joint >= 0 and not free:  # a joint to the world needs a link for the world
        links.append(LinkSpec(0, "world", -1, None, None, (), True))
        pose = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    for head in members:
        bodies = of_head[head]
        inertia = _inertia(model, bodies, frames)
        geoms = _geoms(model, bodies, frames)
        weightless = bool(model.body_gravcomp[head] >= 1.0)
        parent_body = int(model.body_parentid[head])
        parent = last.get(int(heads[parent_body]), 0 if links else -1)
        own = (np.array(model.body_pos[head]), np.array(model.body_quat[head]))
        at = compose(frames[parent_body], own)
        count = 0 if head == root and (free or first_joint < 0) else int(model.body_jntnum[head])
        for index in range(count):
            joint = _joint(model, int(model.body_jntadr[head]) + index, at)
            at = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
            whole = index == count - 1
            slight = Inertia(SLIGHT_MASS_KG, *at, np.full(3, SLIGHT_INERTIA))
            name = model.body(head).name if whole else joint.name
            of_link = (inertia, geoms) if whole else (slight, ())
            links.append(LinkSpec(head, name, parent, joint, *of_link, weightless))
            parent = len(links) - 1
        if count == 0:
            links.append(LinkSpec(head, model.body(head).name, parent, None, inertia, geoms, weightless))
        last[head] = len(links) - 1
    return TreeSpec(
        root="free" if free else "mocap" if mocap >= 0 else "fixed",
        pose=pose,
        qpos=int(model.jnt_qposadr[first_joint]) if free else -1,
        dof=int(model.jnt_dofadr[first_joint]) if free else -1,
        mocap=mocap,
        links=tuple(links),
        touches_own_root=any(
            heads[model.geom_bodyid[geom]] == root for geom in (*model.pair_geom1, *model.pair_geom2)
        ),
    )


def _inertia(model: mujoco.MjModel, bodies: list[int], frames: list[Frame]) -> Inertia | None:
    """Adds the bodies of a link up, by the parallel axis theorem."""
    masses = np.array([model.body_mass[body] for body in bodies])
    if masses.sum() <= 0.0:
        return None
    at = [compose(frames[b], (np.array(model.body_ipos[b]), np.array(model.body_iquat[b]))) for b in bodies]
    if np.count_nonzero(masses) == 1:
        index = int(masses.argmax())
        return Inertia(float(masses.sum()), *at[index], np.array(model.body_inertia[bodies[index]]))
    centre = np.sum([mass * frame[0] for mass, frame in zip(masses, at, strict=True)], axis=0) / masses.sum()
    total = np.zeros((3, 3))
    for body, mass, (pos, rot) in zip(bodies, masses, at, strict=True):
        turn, away = to_matrix(rot), pos - centre
        total += turn @ np.diag(model.body_inertia[body]) @ turn.T
        total += mass * (away @ away * np.eye(3) - np.outer(away, away))
    moments, quat = np.empty(3), np.empty(4)
    mujoco.mju_eig3(moments, np.empty(9), quat, total.ravel())
    return Inertia(float(masses.sum()), centre, quat, moments)


def _joint(model: mujoco.MjModel, joint: int, at: Frame) -> JointSpec:
    qpos, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    hinge = model.jnt_type[joint] == _HINGE
    own = (np.array(model.jnt_pos[joint]), _x_to(np.array(model.jnt_axis[joint])))
    back = -float(model.qpos0[qpos])  # the model's frames are those at qpos0
    turned = np.array([np.cos(back / 2), np.sin(back / 2), 0.0, 0.0]) if hinge else np.array([1.0, 0, 0, 0])
    moved = np.zeros(3) if hinge else np.array([back, 0.0, 0.0])
    actuators = [index for index in range(model.nu) if model.actuator_trnid[index, 0] == joint]
    driven = {}
    if actuators:
        index = actuators[0]
        driven = {
            "actuator": index,
            "kp": -float(model.actuator_biasprm[index, 1]),
            "kd": -float(model.actuator_biasprm[index, 2]),
            "takes_force": not model.actuator_biasprm[index, 1],
        }
        if model.actuator_forcelimited[index]:
            driven["force_limit"] = float(model.actuator_forcerange[index, 1])
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
    return JointSpec(
        name=model.joint(joint).name,
        kind="hinge" if hinge else "slide",
        qpos=qpos,
        dof=dof,
        in_parent=compose(compose(at, own), (moved, turned)),
        in_child=own,
        limits=(float(low), float(high)),
        stiffness=float(np.ravel(model.jnt_stiffness[joint])[0]),
        rest=float(model.qpos_spring[qpos]),
        damping=float(np.ravel(model.dof_damping[dof])[0]),
        friction=float(model.dof_frictionloss[dof]),
        armature=float(model.dof_armature[dof]),
        **driven,
    )


def _x_to(axis: np.ndarray) -> np.ndarray:
    """Returns a turn, wxyz, that takes the x axis to ``axis``."""
    axis = axis / np.linalg.norm(axis)
    if axis[0] < -0.999999:
        return np.array([0.0, 0.0, 1.0, 0.0])
    quat = np.array([1.0 + axis[0], 0.0, -axis[2], axis[1]])
    return quat / np.linalg.norm(quat)


def compose(outer: Frame, inner: Frame) -> Frame:
    """Returns the frame ``inner``, which is given in ``outer``, in whatever ``outer`` is given in."""
    return outer[0] + rotate(outer[1], inner[0]), multiply(outer[1], inner[1])


def inverse(frame: Frame) -> Frame:
    """Returns the frame of the origin in ``frame``."""
    back = conjugate(frame[1])
    return -rotate(back, frame[0]), back
