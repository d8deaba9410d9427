"""A scene in Newton's model builder, and where its joints are in Newton's arrays."""

from dataclasses import dataclass

import mujoco
import newton
import numpy as np
import warp as wp

from envs.mjcf.link_tree import JointSpec, LinkSpec, SceneSpec, TreeSpec, compose
from envs.rotations import to_matrix
from envs.simulators.newton.shapes import ShapeFactory, transform

IDENTITY = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))

SLIGHT_MASS_KG, SLIGHT_INERTIA = 1e-3, 1e-6
"""Mass and inertia of a mocap body that has none."""


@dataclass(frozen=True, slots=True)
class FreeRoot:
    """A root with a free joint.

    Attributes:
        q: Newton's address of its pose: position, then orientation as xyzw.
        qd: Newton's address of its velocity: that of its centre of mass, then its rate of turning, both in
            the world frame.
        qpos: MuJoCo's address of its pose, or -1 for a mocap body.
        dof: MuJoCo's address of its velocity, or -1.
        mocap: Index of the mocap body, or -1.
        centre: Centre of mass in the link, (3,).
    """

    q: int
    qd: int
    qpos: int
    dof: int
    mocap: int
    centre: np.ndarray


@dataclass(frozen=True, slots=True)
class NewtonScene:
    """A builder, and addresses: of joints in Newton's and in MuJoCo's arrays, in one order.

    Attributes:
        builder: Holds one world.
        roots: Roots with a free joint.
        q: Newton's addresses of positions, (J,).
        qd: Newton's addresses of velocities, (J,).
        qpos: MuJoCo's addresses of positions, (J,).
        dof: MuJoCo's addresses of velocities, (J,).
        driven: Newton's addresses of target positions, laid out like positions, (A,).
        actuator: MuJoCo's addresses of their targets, (A,).
        pushed: Newton's addresses of target forces, laid out like velocities, (F,).
        pusher: MuJoCo's addresses of their targets, (F,).
    """

    builder: newton.ModelBuilder
    roots: tuple[FreeRoot, ...]
    q: np.ndarray
    qd: np.ndarray
    qpos: np.ndarray
    dof: np.ndarray
    driven: np.ndarray
    actuator: np.ndarray
    pushed: np.ndarray
    pusher: np.ndarray


def build(model: mujoco.MjModel, spec: SceneSpec) -> NewtonScene:
    """Builds one world from a compiled model.

    Raises:
        SimulatorError: if Newton gets no collision shape for a geom.
    """
    builder = newton.ModelBuilder(gravity=wp.vec3(*model.opt.gravity.tolist()))
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    shapes = ShapeFactory(model, builder)
    for geom, frame in spec.still:
        shapes.add(geom, frame, -1)
    roots: list[FreeRoot] = []
    joints: list[tuple[int, int, JointSpec]] = []
    for tree in spec.trees:
        if tree.root == "mocap" and len(tree.links) == 1 and not tree.links[0].geoms:
            continue  # only seen
        _add_tree(model, builder, shapes, tree, roots, joints)
    shapes.keep_apart()
    driven = [item for item in joints if item[2].actuator >= 0 and not item[2].takes_force]
    pushed = [item for item in joints if item[2].takes_force]
    return NewtonScene(
        builder=builder,
        roots=tuple(roots),
        q=np.array([q for q, _, _ in joints], np.intp),
        qd=np.array([qd for _, qd, _ in joints], np.intp),
        qpos=np.array([joint.qpos for *_, joint in joints], np.intp),
        dof=np.array([joint.dof for *_, joint in joints], np.intp),
        driven=np.array([q for q, _, _ in driven], np.intp),
        actuator=np.array([joint.actuator for *_, joint in driven], np.intp),
        pushed=np.array([qd for _, qd, _ in pushed], np.intp),
        pusher=np.array([joint.actuator for *_, joint in pushed], np.intp),
    )


def _add_tree(
    model: mujoco.MjModel,
    builder: newton.ModelBuilder,
    shapes: ShapeFactory,
    tree: TreeSpec,
    roots: list[FreeRoot],
    joints: list[tuple[int, int, JointSpec]],
) -> None:
    apart = tree.touches_own_root and tree.root == "mocap"
    if apart:  # links do not touch what they are jointed to, so the root's shapes are a body of their own
        body, joint = _add_root(builder, tree, roots)
        builder.add_articulation([joint])
        _add_shapes(shapes, tree.links[0], body)
    body, joint = _add_root(builder, tree, roots)
    bodies, own = [body], [joint]
    if tree.root == "fixed":  # in MuJoCo, links touch what is part of the world
        for geom, frame in tree.links[0].geoms:
            shapes.add(geom, compose(tree.pose, frame), -1)
    elif not apart:
        _add_shapes(shapes, tree.links[0], body)
    for link in tree.links[1:]:
        child = _add_link(builder, link, transform(tree.pose))
        if link.joint is None:
            own.append(builder.add_joint_fixed(bodies[link.parent], child))
        else:
            joints.append((builder.joint_coord_count, builder.joint_dof_count, link.joint))
            own.append(_add_joint(model, builder, bodies[link.parent], child, link.joint))
        bodies.append(child)
        _add_shapes(shapes, link, child)
    builder.add_articulation([index for index in own if index >= 0])


def _add_root(builder: newton.ModelBuilder, tree: TreeSpec, roots: list[FreeRoot]) -> tuple[int, int]:
    """Adds a tree's root; returns its body and its joint."""
    link, at = tree.links[0], transform(tree.pose)
    moves = tree.root == "free"
    body = _add_link(builder, link, at, is_kinematic=tree.root == "mocap")
    if tree.root == "fixed":
        return body, builder.add_joint_fixed(-1, body, parent_xform=at)
    centre = link.inertia.frame[0] if moves and link.inertia is not None else np.zeros(3)
    roots.append(
        FreeRoot(
            builder.joint_coord_count,
            builder.joint_dof_count,
            tree.qpos,
            tree.dof,
            -1 if moves else tree.mocap,
            centre,
        )
    )
    return body, builder.add_joint_free(body)


def _add_link(builder: newton.ModelBuilder, link: LinkSpec, at, *, is_kinematic: bool = False) -> int:
    mass, frame, moments = SLIGHT_MASS_KG, IDENTITY, np.full(3, SLIGHT_INERTIA)
    if link.inertia is not None:
        mass, frame, moments = link.inertia.mass, link.inertia.frame, link.inertia.moments
    turn = to_matrix(np.asarray(frame[1]))
    tensor = turn @ np.diag(moments) @ turn.T
    return builder.add_link(
        xform=at,
        mass=mass,
        com=wp.vec3(*(float(value) for value in frame[0])),
        inertia=wp.mat33(*(float(value) for value in tensor.ravel())),
        lock_inertia=True,
        is_kinematic=is_kinematic,
        custom_attributes={"mujoco:gravcomp": 1.0 if link.weightless else 0.0},
    )


def _add_joint(
    model: mujoco.MjModel, builder: newton.ModelBuilder, parent: int, child: int, joint: JointSpec
) -> int:
    index = int(model.dof_jntid[joint.dof])
    add = builder.add_joint_revolute if joint.kind == "hinge" else builder.add_joint_prismatic
    low, high = (float(np.clip(limit, -1e6, 1e6)) for limit in joint.limits)
    held = joint.actuator >= 0 and not joint.takes_force
    mode = newton.JointTargetMode.POSITION if held else newton.JointTargetMode.NONE
    return add(
        parent,
        child,
        parent_xform=transform(joint.in_parent),
        child_xform=transform(joint.in_child),
        axis=newton.Axis.X,
        target_ke=joint.kp,
        target_kd=joint.kd if held else 0.0,
        damping=joint.damping if held else joint.damping + joint.kd,
        stiffness=joint.stiffness,
        rest_q=joint.rest,
        limit_lower=low,
        limit_upper=high,
        armature=joint.armature,
        friction=joint.friction,
        effort_limit=float(min(joint.force_limit, 1e9)),
        actuator_mode=mode,
        collision_filter_parent=False,
        label=joint.name,
        custom_attributes={  # one value for each degree of freedom
            "mujoco:solreffriction": [model.dof_solref[joint.dof].tolist()],
            "mujoco:solimpfriction": [model.dof_solimp[joint.dof].tolist()],
            "mujoco:solreflimit": [model.jnt_solref[index].tolist()],
            "mujoco:solreflimit_mode": [1],
            "mujoco:solimplimit": [model.jnt_solimp[index].tolist()],
        },
    )


def _add_shapes(shapes: ShapeFactory, link: LinkSpec, body: int) -> None:
    for geom, frame in link.geoms:
        shapes.add(geom, frame, body)
