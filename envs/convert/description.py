"""Description of a robot, independent of the file format: links, joints, shapes and materials.

Metres, kilograms, radians; quaternions wxyz. A link's frame is at its joint's anchor, so that the joint
axis passes through the frame's origin, as URDF and USD require.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from envs.mjcf.link_tree import Inertia

JointKind = Literal["fixed", "hinge", "slide", "ball", "free"]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh in the frame of its shape.

    Attributes:
        name: Its name, unique for its content.
        vertices: (V, 3), m.
        faces: (F, 3) indices of vertices.
        normals: Unit normals, (K, 3), and (F, 3) indices of them; or None.
        uvs: Texture coordinates, (T, 2), v pointing up in the image, and (F, 3) indices; or None.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    normals: tuple[np.ndarray, np.ndarray] | None = None
    uvs: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Appearance of a shape.

    Attributes:
        name: Its name, unique.
        rgba: Colour and opacity; multiplies the image.
        image: Image (H, W, 3) uint8 that texture coordinates refer to, or None.
        roughness: 0 to 1.
        metallic: 0 to 1.
    """

    name: str
    rgba: tuple[float, float, float, float]
    image: np.ndarray | None = None
    roughness: float = 0.7
    metallic: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """One primitive or mesh of a link.

    Attributes:
        kind: ``box`` (half sizes), ``sphere`` (radius), ``cylinder`` or ``capsule`` (radius, half length,
            along z), ``mesh``.
        size: Sizes of a primitive, m.
        pos: Position in the link.
        rot: Orientation in the link.
        material: Its appearance.
        mesh: The mesh of a ``mesh``.
        friction: Sliding friction coefficient.
    """

    kind: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    size: tuple[float, ...]
    pos: np.ndarray
    rot: np.ndarray
    material: Material
    mesh: Mesh | None = None
    friction: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Mimic:
    """A joint that follows another: ``q = offset + multiplier * q_of(joint)``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A position servo: force ``kp (target - q) - kd q̇``, within ±``max_force``."""

    kp: float
    kd: float
    max_force: float


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A joint: how a link moves relative to its parent.

    Attributes:
        name: Its name.
        kind: Its kind; ``free`` for the root alone.
        axis: Unit axis in the link's frame (which is the joint's).
        range: Position limits, rad (m), or None.
        damping: N·m·s/rad (N·s/m).
        friction: Dry friction, N·m (N).
        armature: Rotor inertia reflected to the joint, kg·m² (kg).
        max_force: Largest force of its actuator, N·m (N), or None.
        mimic: The joint that it follows, or None.
        drive: Its position servo, or None.
    """

    name: str
    kind: JointKind
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    range: tuple[float, float] | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    max_force: float | None = None
    mimic: Mimic | None = None
    drive: Drive | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A rigid part.

    Attributes:
        name: Its name.
        body: Id of the source's body, or None for a link between two joints of a body.
        parent: Name of its parent, or None for the root.
        joint: Its joint to its parent; the root's is ``fixed`` or ``free``.
        pos: Position of its frame in the parent where the joint is at 0, m.
        rot: Orientation likewise.
        inertial: Mass and inertia.
        visuals: Visual shapes.
        collisions: Collision shapes; a mesh is convex.
        body_offset: Position of this frame in the frame of the source's body, m.
    """

    name: str
    body: int | None
    parent: str | None
    joint: Joint
    pos: np.ndarray
    rot: np.ndarray
    inertial: Inertia
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    body_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A robot.

    Attributes:
        name: Its name.
        links: Parents before children; the first is the root.
        losses: What the source has and this description cannot represent, one sentence each.
    """

    name: str
    links: tuple[Link, ...]
    losses: tuple[str, ...] = ()

    def shapes(self) -> Iterator[tuple[Shape, Literal["visual", "collision"]]]:
        """Yields every shape and whether it is visual or for collisions."""
        for link in self.links:
            for shape in link.visuals:
                yield shape, "visual"
            for shape in link.collisions:
                yield shape, "collision"

    @property
    def joints(self) -> tuple[Joint, ...]:
        """Joints that move, the free root's aside, in the order of the links."""
        return tuple(link.joint for link in self.links if link.joint.kind in ("hinge", "slide", "ball"))

    @property
    def floating(self) -> bool:
        """Whether the root moves freely."""
        return self.links[0].joint.kind == "free"
