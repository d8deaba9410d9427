"""Trees of links as MJCF for Genesis's loader, which takes one text for each of its entities.

Nothing is left to be guessed: inertias, limits, gains and impedances of constraints are written as they are
in the compiled model, and a mesh as the vertices of its convex hull.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from envs.core.errors import SimulatorError
from envs.mjcf.collision import hull_of
from envs.mjcf.link_tree import Frame, JointSpec, LinkSpec, TreeSpec, compose, inverse
from envs.rotations import rotate

HIDDEN_GROUP = "3"
"""Of geoms that Genesis makes no visual shape of."""

_SHAPES = mujoco.mjtGeom
_NAMES = {
    int(_SHAPES.mjGEOM_PLANE): "plane",
    int(_SHAPES.mjGEOM_BOX): "box",
    int(_SHAPES.mjGEOM_SPHERE): "sphere",
    int(_SHAPES.mjGEOM_CAPSULE): "capsule",
    int(_SHAPES.mjGEOM_CYLINDER): "cylinder",
    int(_SHAPES.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_SHAPES.mjGEOM_MESH): "mesh",
}


@dataclass(frozen=True, slots=True)
class Text:
    """Parts of one Genesis entity.

    Attributes:
        mjcf: The text.
        geoms: Name of a link to the ids of its geoms, in their order.
    """

    mjcf: str
    geoms: Mapping[str, Sequence[int]]


def joint_name(joint: JointSpec) -> str:
    """Returns the name of a joint in the text."""
    return f"joint{joint.dof}"


def write_still(model: mujoco.MjModel, geoms: Iterable[tuple[int, Frame]]) -> Text:
    """Returns the MJCF of what never moves.

    Args:
        model: The compiled scene.
        geoms: Ids, and frames in the world.

    Raises:
        SimulatorError: if a geom is of a kind that Genesis has no shape for.
    """
    writer = _Writer(model)
    writer.geoms(writer.world, geoms)
    return writer.text()


def write_tree(model: mujoco.MjModel, tree: TreeSpec, *, bare_root: bool, whole: bool = True) -> Text:
    """Returns the MJCF of a tree. A root that is put in place is written at the origin.

    Args:
        model: The compiled scene.
        tree: What is written.
        bare_root: Leaves out the shapes of the root.
        whole: Writes all links, not only the root.

    Raises:
        SimulatorError: if a geom is of a kind that Genesis has no shape for.
    """
    writer = _Writer(model)
    root = tree.links[0]
    pose = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])) if tree.root == "mocap" else tree.pose
    element = writer.body(writer.world, "root", pose, root, bare=bare_root)
    if tree.root == "free":
        ET.SubElement(element, "freejoint", name="free")
    bodies = [element]
    for index, link in enumerate(tree.links[1:] if whole else (), start=1):
        assert link.joint is not None, "only the root of a tree has no joint"
        at = _at(link.joint)
        bodies.append(writer.body(bodies[link.parent], f"link{index}", at, link))
        writer.joint(bodies[-1], link.joint)
    return writer.text()


def _at(joint: JointSpec) -> Frame:
    """Returns where a link is in its parent while the joint's spring is at rest."""
    rest = joint.rest if joint.stiffness > 0.0 else 0.0
    moved = np.zeros(3), np.array([np.cos(rest / 2), np.sin(rest / 2), 0.0, 0.0])
    if joint.kind == "slide":
        moved = np.array([rest, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    return compose(compose(joint.in_parent, moved), inverse(joint.in_child))


class _Writer:
    """One MJCF text."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._root = ET.Element("mujoco")
        ET.SubElement(self._root, "compiler", angle="radian", inertiafromgeom="false", autolimits="false")
        self._assets = ET.SubElement(self._root, "asset")
        self.world = ET.SubElement(self._root, "worldbody")
        self._actuators = ET.SubElement(self._root, "actuator")
        self._meshes: set[int] = set()
        self._placed: dict[str, list[int]] = {}

    def text(self) -> Text:
        """Returns it."""
        return Text(ET.tostring(self._root, encoding="unicode"), self._placed)

    def body(
        self, parent: ET.Element, name: str, pose: Frame, link: LinkSpec, *, bare: bool = False
    ) -> ET.Element:
        """Adds a link."""
        element = ET.SubElement(parent, "body", name=name, pos=_words(pose[0]), quat=_words(pose[1]))
        if link.inertia is not None:
            ET.SubElement(
                element,
                "inertial",
                mass=repr(float(link.inertia.mass)),
                pos=_words(link.inertia.frame[0]),
                quat=_words(link.inertia.frame[1]),
                diaginertia=_words(link.inertia.moments),
            )
        self.geoms(element, () if bare else link.geoms)
        return element

    def joint(self, body: ET.Element, joint: JointSpec) -> None:
        """Adds the joint of a link, and what drives it."""
        index = int(self._model.dof_jntid[joint.dof])
        limited = bool(np.isfinite(joint.limits).all())
        ET.SubElement(
            body,
            "joint",
            name=joint_name(joint),
            type=joint.kind,
            pos=_words(joint.in_child[0]),
            axis=_words(rotate(joint.in_child[1], np.array([1.0, 0.0, 0.0]))),
            ref=repr(joint.rest if joint.stiffness > 0.0 else 0.0),
            limited="true" if limited else "false",
            range=_words(joint.limits if limited else (0.0, 0.0)),
            stiffness=repr(joint.stiffness),
            damping=repr(joint.damping),
            frictionloss=repr(joint.friction),
            armature=repr(joint.armature),
            solreflimit=_words(self._model.jnt_solref[index]),
            solimplimit=_words(self._model.jnt_solimp[index]),
        )
        if joint.actuator < 0:
            return
        strong = np.isfinite(joint.force_limit)
        limit = float(joint.force_limit) if strong else 0.0
        ET.SubElement(
            self._actuators,
            "general",
            joint=joint_name(joint),
            gainprm=repr(joint.kp),
            biastype="affine",
            biasprm=_words((0.0, -joint.kp, -joint.kd)),
            ctrllimited="false",
            forcelimited="true" if strong else "false",
            forcerange=_words((-limit, limit)),
        )

    def geoms(self, body: ET.Element, geoms: Iterable[tuple[int, Frame]]) -> None:
        """Adds the shapes of a link. Genesis is to let all touch; who does is decided after it is built."""
        model, placed = self._model, self._placed.setdefault(body.get("name", "world"), [])
        for geom, frame in geoms:
            placed.append(geom)
            kind = _NAMES.get(int(model.geom_type[geom]))
            if kind is None:
                name = model.geom(geom).name or f"number {geom}"
                raise SimulatorError(
                    f"Genesis gets no collision shape for the geom '{name}' "
                    f"({_SHAPES(int(model.geom_type[geom])).name}). Take simulator=mujoco."
                )
            element = ET.SubElement(
                body,
                "geom",
                type=kind,
                pos=_words(frame[0]),
                quat=_words(frame[1]),
                group=HIDDEN_GROUP,
                contype="1",
                conaffinity="1",
                condim=str(int(model.geom_condim[geom])),
                friction=_words(model.geom_friction[geom]),
                solref=_words(model.geom_solref[geom]),
                solimp=_words(model.geom_solimp[geom]),
            )
            if kind == "mesh":
                element.set("mesh", self._mesh(geom))
            elif kind != "plane":
                element.set("size", _words(model.geom_size[geom]))
            else:
                element.set("size", "0 0 1")

    def _mesh(self, geom: int) -> str:
        mesh = int(self._model.geom_dataid[geom])
        if mesh not in self._meshes:
            self._meshes.add(mesh)
            points = hull_of(self._model, geom)
            ET.SubElement(self._assets, "mesh", name=f"mesh{mesh}", vertex=_words(points.ravel()))
        return f"mesh{mesh}"


def _words(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
