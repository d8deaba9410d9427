"""Makes PhysX's bodies, links and joints from the trees of a model."""

import numpy as np
import sapien
from sapien import Pose, physx

from envs.mjcf.link_tree import JointSpec, LinkSpec, TreeSpec
from envs.simulators.sapien.articulation import Articulation
from envs.simulators.sapien.bodies import FreeBody, KinematicBody, Part
from envs.simulators.sapien.collision_groups import root_is_apart
from envs.simulators.sapien.settings import SapienSettings
from envs.simulators.sapien.shapes import ShapeFactory, pose_of

HOLD = 1e4
"""Velocity gain, N·m·s/rad (N·s/m), of the drive that models dry friction; its force limit is the
friction. Below that force the joint creeps by less than a milliradian per second."""

MAX_SPEED = 1000.0
"""Linear, m/s, and angular, rad/s: PhysX's own limits of 10 and 50 slow down what falls."""


class TreeBuilder:
    """Makes what the trees of a scene consist of."""

    def __init__(self, scene: sapien.Scene, shapes: ShapeFactory, settings: SapienSettings) -> None:
        self._scene, self._shapes = scene, shapes
        self._iterations = settings.position_iterations, settings.velocity_iterations

    def parts(self, tree: TreeSpec) -> list[Part]:
        """Makes what a tree consists of."""
        root = tree.links[0]
        if len(tree.links) == 1:
            return [self._body(tree, root)]
        parts: list[Part] = []
        apart = root_is_apart(tree)
        if apart:  # PhysX keeps a link from touching its parent, so the root's shapes are a body of its own
            parts.append(self._body(tree, root))
        return [*parts, self._articulation(tree, bare_root=apart)]

    def _body(self, tree: TreeSpec, link: LinkSpec) -> Part:
        component = physx.PhysxRigidDynamicComponent()
        self._furnish(component, link)
        component.kinematic = tree.root != "free"
        entity = add_entity(self._scene, component, link.name, pose_of(tree.pose))
        if tree.root != "free":
            return KinematicBody(entity, tree.mocap)
        component.solver_position_iterations, component.solver_velocity_iterations = self._iterations
        component.sleep_threshold = 0.0
        return FreeBody(component, tree)

    def _articulation(self, tree: TreeSpec, *, bare_root: bool) -> Part:
        components: list[physx.PhysxArticulationLinkComponent] = []
        entities: list[sapien.Entity] = []  # a component does not keep its entity alive
        for link in tree.links:
            parent = components[link.parent] if link.parent >= 0 else None
            component = physx.PhysxArticulationLinkComponent(parent)
            self._furnish(component, link, bare=bare_root and parent is None)
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
        return Articulation(articulation, tree)

    def _furnish(self, component, link: LinkSpec, *, bare: bool = False) -> None:
        for geom, frame in () if bare else link.geoms:
            component.attach(self._shapes.make(geom, frame))
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


def add_entity(scene: sapien.Scene, component, name: str, pose: Pose) -> sapien.Entity:
    """Adds an entity that has one component."""
    entity = sapien.Entity()
    entity.add_component(component)
    entity.name = name
    entity.pose = pose
    scene.add_entity(entity)
    return entity
