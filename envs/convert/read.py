"""Reads a compiled MuJoCo model into a :class:`~envs.convert.description.Description`."""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from envs.convert.description import Description, Drive, Joint, JointKind, Link, Mimic
from envs.convert.shapes import ShapeReader
from envs.core.errors import ConfigError
from envs.mjcf.link_tree import Inertia
from envs.rotations import multiply, rotate
from envs.scenario.units import IDENTITY

TINY_MASS_KG = 1e-7
TINY_INERTIA = 1e-9
"""Mass of a moving link that has none, such as one between two joints of a body: formats allow one joint per
link, and simulators require a positive mass. A robot's mass is about 10⁸ times that."""

_JOINT = mujoco.mjtJoint
_KINDS: dict[int, JointKind] = {
    int(_JOINT.mjJNT_FREE): "free",
    int(_JOINT.mjJNT_BALL): "ball",
    int(_JOINT.mjJNT_SLIDE): "slide",
    int(_JOINT.mjJNT_HINGE): "hinge",
}
_EQ = mujoco.mjtEq


def read_model(
    model: mujoco.MjModel,
    name: str,
    *,
    prefix: str = "",
    mesh_files: Mapping[str, Path] | None = None,
    root: int = 0,
) -> Description:
    """Describes a robot.

    Args:
        model: The compiled model of one robot.
        name: Name of the robot.
        prefix: Prefix of the model's names, which is removed.
        mesh_files: Mesh name to its file, beside which a textured variant is searched.
        root: Top body of the robot in a model that holds other things too; the description starts there, at
        its pose. 0 is the whole model.

    Raises:
        ConfigError: if several trees are not connected, so that it is not one robot.
    """
    return _Reader(model, prefix, mesh_files or {}).description(name, root)


class _Reader:
    def __init__(self, model: mujoco.MjModel, prefix: str, mesh_files: Mapping[str, Path]) -> None:
        self.model = model
        self.prefix = prefix
        self.shapes = ShapeReader(model, mesh_files)
        self.losses: list[str] = []
        self.link_of_body: dict[int, Link] = {}
        self.joint_names = self._names(model.njnt, lambda i: model.joint(i).name, "joint")
        self.body_names = self._names(model.nbody, lambda i: model.body(i).name, "body")
        self.mimics = self._mimics()

    def _names(self, count: int, name_of, kind: str) -> list[str]:
        return [name_of(index).removeprefix(self.prefix) or f"{kind}{index}" for index in range(count)]

    def description(self, name: str, root: int) -> Description:
        model = self.model
        if root:
            return self._tree(name, root)
        tops = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
        floating = [top for top in tops if self._kinds(top)[:1] == ["free"]]
        if len(floating) > 1 or (floating and len(tops) > 1):
            names = ", ".join(self.body_names[top] for top in tops)
            raise ConfigError(
                f"'{name}' holds {len(tops)} separate bodies ({names}); a description "
                "holds one robot. Name its body, as in root=" + self.body_names[tops[0]] + "."
            )
        links: list[Link] = []
        if not self._is_root(tops):
            still = Inertia(0.0, np.zeros(3), np.array(IDENTITY), np.zeros(3))
            links.append(self._with_shapes(0, Link("world", 0, None, _fixed("world"), *_at_origin(), still)))
            self.link_of_body[0] = links[0]
        for body in range(1, model.nbody):
            links += self._links(body)
        self._note_losses()
        return Description(name, tuple(links), (*self.losses, *self.shapes.losses))

    def _tree(self, name: str, root: int) -> Description:
        """Describes a top body of a scene with its descendants, and the world if it is jointed to it."""
        model, links = self.model, []
        if self._kinds(root) not in ([], ["free"]):
            still = Inertia(0.0, np.zeros(3), np.array(IDENTITY), np.zeros(3))
            self.link_of_body[0] = Link("world", 0, None, _fixed("world"), *_at_origin(), still)
            links.append(self.link_of_body[0])
        for body in range(root, model.nbody):
            if body == root or model.body_rootid[body] == root:
                links += self._links(body)
        return Description(name, tuple(links))

    def _is_root(self, tops: list[int]) -> bool:
        """Whether the only top body can be the root itself: it floats, or is fixed at the origin."""
        model = self.model
        if len(tops) != 1 or any(int(kind) != 0 for kind in model.geom_type[model.geom_bodyid == 0]):
            return False
        kinds, top = self._kinds(tops[0]), tops[0]
        if kinds == ["free"]:
            return True
        return not kinds and not model.body_pos[top].any() and tuple(model.body_quat[top]) == IDENTITY

    def _kinds(self, body: int) -> list[JointKind]:
        return [_KINDS[int(self.model.jnt_type[joint])] for joint in self._joints(body)]

    def _joints(self, body: int) -> range:
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def _links(self, body: int) -> list[Link]:
        """Converts a body to a chain of links, one per joint; the last one is the body."""
        model, joints, name = self.model, self._joints(body), self.body_names[body]
        parent = self.link_of_body.get(int(model.body_parentid[body]))
        if parent is None or self._kinds(body) == ["free"]:
            joint = Joint(self.joint_names[joints[0]], "free") if joints else _fixed(f"{name}_fixed")
            last = self._body_link(body, None, joint, np.zeros(3), np.array(IDENTITY), np.zeros(3))
            self.link_of_body[body] = last
            return [last]
        pos, rot = model.body_pos[body] - parent.body_offset, model.body_quat[body].copy()
        reached, links, parent_name = np.zeros(3), [], parent.name
        for joint in joints:
            pos, rot, reached = self._frame(joint, pos, rot, reached)
            if joint == joints[-1]:
                links.append(self._body_link(body, parent_name, self._joint(joint), pos, rot, reached))
                break
            between = f"{name}/{self.joint_names[joint]}"
            links.append(Link(between, None, parent_name, self._joint(joint), pos, rot, _light()))
            parent_name, (pos, rot) = between, _at_origin()
        if not joints:
            links.append(self._body_link(body, parent_name, _fixed(f"{name}_fixed"), pos, rot, reached))
        self.link_of_body[body] = links[-1]
        return links

    def _frame(
        self, joint: int, pos: np.ndarray, rot: np.ndarray, reached: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moves a frame to a joint's anchor, with the joint at position 0 (the model is at ``qpos0``).

        Returns:
            Position and orientation in the parent's frame, and the frame's position in the body.
        """
        model = self.model
        kind, axis = _KINDS[int(model.jnt_type[joint])], model.jnt_axis[joint]
        if kind == "slide":
            zero = float(model.qpos0[model.jnt_qposadr[joint]])
            return pos - zero * rotate(rot, axis), rot, reached
        anchor = model.jnt_pos[joint]
        pos = pos + rotate(rot, anchor - reached)
        if kind == "hinge":
            half = -0.5 * float(model.qpos0[model.jnt_qposadr[joint]])
            rot = multiply(rot, np.array([np.cos(half), *(np.sin(half) * axis)]))
        return pos, rot, anchor.copy()

    def _body_link(
        self,
        body: int,
        parent: str | None,
        joint: Joint,
        pos: np.ndarray,
        rot: np.ndarray,
        offset: np.ndarray,
    ) -> Link:
        model, name = self.model, self.body_names[body]
        inertial = Inertia(
            mass=float(model.body_mass[body]),
            com=model.body_ipos[body] - offset,
            rot=model.body_iquat[body].copy(),
            moments=model.body_inertia[body].copy(),
        )
        if inertial.mass == 0 and joint.kind != "fixed":  # MuJoCo allows it if its children have mass
            inertial = _light()
        link = Link(name, body, parent, joint, pos, rot, inertial, body_offset=offset)
        return self._with_shapes(body, link)

    def _with_shapes(self, body: int, link: Link) -> Link:
        first, count = int(self.model.body_geomadr[body]), int(self.model.body_geomnum[body])
        visuals, collisions = [], []
        for geom in range(first, first + count):
            if self.shapes.visible(geom):
                visuals.append(self.shapes.shape(geom, link.body_offset, convex=False))
            if self.shapes.collides(geom):
                collisions.append(self.shapes.shape(geom, link.body_offset, convex=True))
        return Link(
            link.name,
            link.body,
            link.parent,
            link.joint,
            link.pos,
            link.rot,
            link.inertial,
            tuple(shape for shape in visuals if shape is not None),
            tuple(shape for shape in collisions if shape is not None),
            link.body_offset,
        )

    def _joint(self, joint: int) -> Joint:
        model, dof = self.model, int(self.model.jnt_dofadr[joint])
        low, high = (float(value) for value in model.jnt_range[joint])
        drive, max_force = self._drive(joint)
        if model.jnt_stiffness[joint]:
            self.losses.append(f"Joint '{self.joint_names[joint]}' has a spring, which is left out.")
        return Joint(
            name=self.joint_names[joint],
            kind=_KINDS[int(model.jnt_type[joint])],
            axis=model.jnt_axis[joint].copy(),
            range=(low, high) if model.jnt_limited[joint] else None,
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            max_force=max_force,
            mimic=self.mimics.get(joint),
            drive=drive,
        )

    def _drive(self, joint: int) -> tuple[Drive | None, float | None]:
        """Returns the joint's position servo, and the largest force of its actuator."""
        model, limits, drive = self.model, [], None
        if model.jnt_actfrclimited[joint]:
            limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
        for index in range(model.nu):
            if int(model.actuator_trntype[index]) != int(mujoco.mjtTrn.mjTRN_JOINT):
                continue
            if int(model.actuator_trnid[index, 0]) != joint:
                continue
            gear, gain = float(model.actuator_gear[index, 0]), float(model.actuator_gainprm[index, 0])
            if model.actuator_forcelimited[index]:
                limits.append(abs(gear) * float(np.abs(model.actuator_forcerange[index]).max()))
            elif model.actuator_ctrllimited[index] and not model.actuator_biasprm[index].any():
                limits.append(abs(gear * gain) * float(np.abs(model.actuator_ctrlrange[index]).max()))
            stiffness, damping = (-float(v) * gear**2 for v in model.actuator_biasprm[index, 1:3])
            if gain > 0 and np.isclose(gain * gear**2, stiffness):
                drive = Drive(stiffness, damping, np.inf)
        max_force = min(limits) if limits else None
        if drive is not None and max_force is not None:
            drive = Drive(drive.kp, drive.kd, max_force)
        return drive, max_force

    def _mimics(self) -> dict[int, Mimic]:
        """Joints that an equality of joints, or of a tendon, couples linearly to another one."""
        model, mimics = self.model, {}
        for index in range(model.neq):
            kind, first, second = (
                int(array[index]) for array in (model.eq_type, model.eq_obj1id, model.eq_obj2id)
            )
            pair, poly = None, model.eq_data[index]
            if kind == int(_EQ.mjEQ_JOINT) and second >= 0 and not poly[2:5].any():
                pair = (first, second, float(poly[1]), float(poly[0]))
            elif kind == int(_EQ.mjEQ_TENDON) and second < 0:
                pair = self._tendon_pair(first, float(poly[0]))
            if pair is None:
                name = _EQ(kind).name.removeprefix("mjEQ_").lower()
                self.losses.append(
                    f"Equality {index} ({name}) is no linear coupling of two joints: it is left out."
                )
                continue
            follower, leader, slope, constant = pair
            rest, lead_rest = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader))
            if follower in mimics or follower == leader:
                continue
            offset = rest + constant - slope * lead_rest
            mimics[follower] = Mimic(self.joint_names[leader], slope, offset)
        return mimics

    def _tendon_pair(self, tendon: int, constant: float) -> tuple[int, int, float, float] | None:
        """A fixed tendon of constant length over two joints: ``c₁ Δq₁ + c₂ Δq₂ = constant``."""
        model = self.model
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        wraps = range(first, first + count)
        if count != 2 or any(int(model.wrap_type[w]) != int(mujoco.mjtWrap.mjWRAP_JOINT) for w in wraps):
            return None
        (one, other), (c1, c2) = model.wrap_objid[wraps], model.wrap_prm[wraps]
        if c2 == 0.0:
            return None
        # The later joint follows the earlier one, which is nearer to the root.
        return int(other), int(one), -float(c1) / float(c2), constant / float(c2)

    def _note_losses(self) -> None:
        model = self.model
        if model.ntendon and not self.mimics:
            self.losses.append(f"{model.ntendon} tendons are left out.")
        if model.nexclude or model.npair:
            self.losses.append("Contact pairs and exclusions of bodies are left out.")


def _fixed(name: str) -> Joint:
    return Joint(name, "fixed")


def _light() -> Inertia:
    return Inertia(TINY_MASS_KG, np.zeros(3), np.array(IDENTITY), np.full(3, TINY_INERTIA))


def _at_origin() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(3), np.array(IDENTITY)
