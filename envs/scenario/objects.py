"""Objects: rigid, articulated, fixed, or visual only, as frozen data."""

import math
from dataclasses import dataclass
from typing import Literal, Self

from envs.core.errors import ConfigError, unknown_name
from envs.scenario.units import IDENTITY, AssetRef, Quat, Rgba, Vec3

_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "mesh": 3}
"""Shapes, and how many sizes each has."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GeomCfg:
    """One primitive or mesh of an object, in the frame of its link.

    Attributes:
        shape: ``box`` (half sizes), ``sphere`` (radius), ``cylinder`` or ``capsule`` (radius, half
            length), ``mesh`` (scale along x, y, z).
        size: Sizes of the shape, m.
        mesh: Asset reference of a mesh's file; a mesh that collides is taken for its convex hull.
        texture: Asset reference of an image for a mesh with texture coordinates, or None.
        pos: Position in the link, m.
        rot: Orientation in the link, wxyz.
        rgba: Colour and opacity.
        mass_kg: Mass.
        friction: Sliding, torsional and rolling friction coefficients.
        condim: Directions in which MuJoCo's contacts have friction: 3 slide, 4 turn too.
        collides: Whether it collides.
        visible: Whether it is rendered.
    """

    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    size: tuple[float, ...]
    mesh: AssetRef | None = None
    texture: AssetRef | None = None
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY
    rgba: Rgba = (0.6, 0.6, 0.6, 1.0)
    mass_kg: float = 0.0
    friction: Vec3 = (1.0, 0.005, 0.0001)
    condim: Literal[3, 4] = 4
    collides: bool = True
    visible: bool = True

    def __post_init__(self) -> None:
        if self.shape not in _SIZES:
            raise unknown_name("shape of a geom", self.shape, _SIZES)
        expected = _SIZES[self.shape]
        if len(self.size) != expected or min(self.size) <= 0:
            raise ConfigError(f"A {self.shape} has {expected} positive sizes, given {self.size}.")
        if (self.mesh is not None) != (self.shape == "mesh"):
            raise ConfigError(
                f"A mesh, and nothing else, names its file; given {self.shape} with {self.mesh}."
            )

    @classmethod
    def box(
        cls,
        half: Vec3,
        pos: Vec3,
        rgba: Rgba,
        density_kg_m3: float,
        *,
        rot: Quat = IDENTITY,
        friction: Vec3 = (1.0, 0.005, 0.0001),
        collides: bool = True,
    ) -> Self:
        """Returns a box with the mass of its volume.

        Args:
            half: Half its sizes, m.
            pos: Position in the link, m.
            rgba: Colour and opacity.
            density_kg_m3: Density.
            rot: Orientation in the link, wxyz.
            friction: Sliding, torsional and rolling friction coefficients.
            collides: Whether it collides.
        """
        return cls(
            shape="box",
            size=half,
            pos=pos,
            rot=rot,
            rgba=rgba,
            mass_kg=8.0 * math.prod(half) * density_kg_m3,
            friction=friction,
            collides=collides,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectJointCfg:
    """A joint of an articulated object; nothing drives it.

    Attributes:
        kind: ``hinge`` turns about ``axis``, ``slide`` moves along it.
        axis: Direction in the link.
        range: Position limits, rad (m).
        pos: A point of a hinge's axis in the link, m.
        default: Rest position, rad (m).
        damping: N·m·s/rad (N·s/m).
        frictionloss: Dry friction, N·m (N).
        stiffness: Spring towards ``springref``, N·m/rad (N/m).
        springref: Where the spring is at rest, rad (m).
        armature: Added inertia, kg·m² (kg).
    """

    kind: Literal["hinge", "slide"]
    axis: Vec3
    range: tuple[float, float]
    pos: Vec3 = (0.0, 0.0, 0.0)
    default: float = 0.0
    damping: float = 0.0
    frictionloss: float = 0.0
    stiffness: float = 0.0
    springref: float = 0.0
    armature: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkCfg:
    """A part of an articulated object. It does not collide with its parent: its joint's range limits it.

    Attributes:
        name: Its name, and its joint's, within the object.
        geoms: What it is made of.
        joint: How it moves against its parent, or None if it is fixed to it.
        parent: Another link, or None for the object's root.
        pos: Position in the parent, m.
        rot: Orientation in the parent, wxyz.
    """

    name: str
    geoms: tuple[GeomCfg, ...]
    joint: ObjectJointCfg | None = None
    parent: str | None = None
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectCfg:
    """An object: geoms of its root, links that are jointed to it, or a body of an MJCF file.

    Attributes:
        name: Its name in the scene and in the state.
        geoms: Geoms of the root.
        links: Further parts, parents before children.
        mjcf: Asset reference of a file that describes the object instead, or None.
        mjcf_root: Body of the file that is the object; its first top body by default.
        mjcf_joints: Joints of the file in our order; one without a name is called after its body.
        mjcf_shown: Visible geom groups of the file, or None for all but collision-only ones.
        mjcf_radians: The file's angles are in radians, though it does not say so: robosuite's parts.
        pos: Position at rest, m; it replaces the file's.
        rot: Orientation at rest, wxyz; likewise.
        kind: ``free`` moves under physics; ``fixed`` stays at its pose of the start of an episode;
            ``marker`` does too, and is visual only.
        feels: Robots, objects, links (``"<object>/<link>"``) with what is jointed to them, or
            ``"ground"``, whose touch is part of its state.
        pulls: Body, such as ``"sawyer/hand"``, that a soft weld pulls to the place of this object,
            which is no free one; None pulls nothing.
    """

    name: str
    geoms: tuple[GeomCfg, ...] = ()
    links: tuple[LinkCfg, ...] = ()
    mjcf: AssetRef | None = None
    mjcf_root: str | None = None
    mjcf_joints: tuple[str, ...] = ()
    mjcf_shown: tuple[int, ...] | None = None
    mjcf_radians: bool = False
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY
    kind: Literal["free", "fixed", "marker"] = "free"
    feels: tuple[str, ...] = ()
    pulls: str | None = None

    def __post_init__(self) -> None:
        if self.mjcf is None and not (self.geoms or self.links):
            raise ConfigError(f"Object '{self.name}' has neither geoms, nor links, nor an MJCF file.")
        if self.mjcf is None and (self.mjcf_joints or self.mjcf_root):
            raise ConfigError(f"Object '{self.name}' names parts of an MJCF file, but no file (mjcf=…).")
        if self.kind == "free" and self.mjcf is None and not any(geom.mass_kg > 0 for geom in self.geoms):
            raise ConfigError(f"Object '{self.name}' is free, so a geom of its root needs mass_kg above 0.")
        if self.pulls is not None and self.kind == "free":
            raise ConfigError(f"Object '{self.name}' is free, so it cannot pull '{self.pulls}'.")
        known: list[str] = []
        for link in self.links:
            if link.parent is not None and link.parent not in known:
                raise unknown_name(
                    f"parent of link '{link.name}' of object '{self.name}'", link.parent, known
                )
            if link.joint is not None and not any(geom.mass_kg > 0 for geom in link.geoms):
                raise ConfigError(
                    f"Link '{link.name}' of object '{self.name}' moves, so a geom of it needs a mass_kg."
                )
            known.append(link.name)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of its joints, in the order of its state: those of its links, then those of its file."""
        return (*(link.name for link in self.links if link.joint is not None), *self.mjcf_joints)
