"""Parts, sites and collision boxes of an object from its MJCF file, placed by its state alone.

No simulator is involved: poses follow from an entity's root pose and joint positions, so a rule that needs
the pose of a drawer or of a site in it is the same on every simulator. Shapes: N environments.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name
from envs.rotations import multiply, rotate
from envs.state import EntityState

_KINDS = {int(mujoco.mjtJoint.mjJNT_HINGE): "hinge", int(mujoco.mjtJoint.mjJNT_SLIDE): "slide"}
_BOX, _SPHERE, _CAPSULE, _CYLINDER = (
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
    )
)


@dataclass(frozen=True, slots=True, eq=False)
class PartJoint:
    """How a part moves against its parent.

    Attributes:
        name: Its name.
        kind: ``hinge`` or ``slide``.
        column: Its column of ``joint_pos``.
        axis: Direction in the part, (3,).
        anchor: A point of a hinge's axis in the part, m, (3,).
        limits: Least and largest position, rad (m).
    """

    name: str
    kind: str
    column: int
    axis: np.ndarray
    anchor: np.ndarray
    limits: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A body of an object.

    Attributes:
        name: Its name.
        parent: Index of its parent, or -1 for the root.
        pos: Position in the parent, m, (3,).
        rot: Orientation in the parent, wxyz, (4,).
        joint: How it moves, or None.
    """

    name: str
    parent: int
    pos: np.ndarray
    rot: np.ndarray
    joint: PartJoint | None


@dataclass(frozen=True, slots=True, eq=False)
class PartBox:
    """A site, or the box round a collision geom.

    Attributes:
        part: Index of its part.
        pos: Middle in the part, m, (3,).
        rot: Orientation in the part, wxyz, (4,).
        half: Half sizes, m, (3,).
    """

    part: int
    pos: np.ndarray
    rot: np.ndarray
    half: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ObjectParts:
    """An object's parts.

    Attributes:
        parts: Bodies, parents first; the first is the root.
        sites: Name to site.
        boxes: What collides.
    """

    parts: tuple[Part, ...]
    sites: dict[str, PartBox]
    boxes: tuple[PartBox, ...]

    @property
    def joints(self) -> tuple[PartJoint, ...]:
        """Its joints, in the order of ``joint_pos``."""
        return tuple(part.joint for part in self.parts if part.joint is not None)

    def site(self, name: str) -> PartBox:
        """Returns a site.

        Raises:
            UnknownNameError: It has no such site.
        """
        if name not in self.sites:
            raise unknown_name("site", name, self.sites)
        return self.sites[name]

    def part_pose(self, entity: EntityState, part: int) -> tuple[Tensor, Tensor]:
        """Returns positions (N, 3) and orientations (N, 4) of a part in the world."""
        chain = [part]
        while self.parts[chain[-1]].parent >= 0:
            chain.append(self.parts[chain[-1]].parent)
        pos, rot = entity.pos, entity.rot
        for index in reversed(chain[:-1]):
            own = self.parts[index]
            pos, rot = _placed(pos, rot, own.pos, own.rot)
            if own.joint is not None:
                pos, rot = _moved(pos, rot, own.joint, entity.joint_pos[:, own.joint.column])
        return pos, rot

    def box_pose(self, entity: EntityState, box: PartBox) -> tuple[Tensor, Tensor]:
        """Returns positions (N, 3) and orientations (N, 4) of a site or a box in the world."""
        return _placed(*self.part_pose(entity, box.part), box.pos, box.rot)


def _placed(pos: Tensor, rot: Tensor, offset: np.ndarray, turn: np.ndarray) -> tuple[Tensor, Tensor]:
    return pos + rotate(rot, pos.new_tensor(offset).expand_as(pos)), multiply(
        rot, rot.new_tensor(turn).expand_as(rot)
    )


def _moved(pos: Tensor, rot: Tensor, joint: PartJoint, by: Tensor) -> tuple[Tensor, Tensor]:
    axis = pos.new_tensor(joint.axis)
    if joint.kind == "slide":
        return pos + rotate(rot, by[:, None] * axis), rot
    turn = torch.cat([torch.cos(by / 2)[:, None], torch.sin(by / 2)[:, None] * axis], dim=-1)
    anchor = pos.new_tensor(joint.anchor).expand_as(pos)
    turned = multiply(rot, turn)
    return pos + rotate(rot, anchor) - rotate(turned, anchor), turned


@lru_cache(maxsize=256)
def parts_of(path: Path, root: str = "object") -> ObjectParts:
    """Reads the body ``root`` of an MJCF file; its own free joint does not count.

    Raises:
        ConfigError: The file cannot be read, or a part has several joints, or one of another kind.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ConfigError(f"'{path}' is no MJCF file: {' '.join(str(error).split())}") from error
    top = model.body(root).id
    members = [body for body in range(model.nbody) if _is_below(model, body, top)]
    index = {body: place for place, body in enumerate(members)}
    parts, columns = [], 0
    for body in members:
        joint = _joint(model, body, columns, path)
        columns += joint is not None
        still = body == top
        parts.append(
            Part(
                name=model.body(body).name,
                parent=-1 if still else index[int(model.body_parentid[body])],
                pos=np.zeros(3) if still else np.array(model.body_pos[body]),
                rot=np.array((1.0, 0, 0, 0)) if still else np.array(model.body_quat[body]),
                joint=joint,
            )
        )
    sites = {
        model.site(site).name: PartBox(
            index[int(model.site_bodyid[site])],
            np.array(model.site_pos[site]),
            np.array(model.site_quat[site]),
            np.array(model.site_size[site]),
        )
        for site in range(model.nsite)
        if int(model.site_bodyid[site]) in index
    }
    boxes = [
        PartBox(
            index[int(model.geom_bodyid[geom])],
            np.array(model.geom_pos[geom]),
            np.array(model.geom_quat[geom]),
            _half_sizes(model, geom),
        )
        for geom in range(model.ngeom)
        if int(model.geom_bodyid[geom]) in index
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    return ObjectParts(tuple(parts), sites, tuple(boxes))


def _is_below(model: mujoco.MjModel, body: int, top: int) -> bool:
    while body > top:
        body = int(model.body_parentid[body])
    return body == top


def _joint(model: mujoco.MjModel, body: int, column: int, path: Path) -> PartJoint | None:
    first = int(model.body_jntadr[body])
    joints = [
        joint
        for joint in range(first, first + int(model.body_jntnum[body]))
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE
    ]
    if not joints:
        return None
    joint = joints[0]
    if len(joints) > 1 or int(model.jnt_type[joint]) not in _KINDS:
        raise ConfigError(f"The body '{model.body(body).name}' of '{path}' needs one hinge or one slide.")
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
    return PartJoint(
        name=model.joint(joint).name or model.body(body).name,
        kind=_KINDS[int(model.jnt_type[joint])],
        column=column,
        axis=np.array(model.jnt_axis[joint]),
        anchor=np.array(model.jnt_pos[joint]),
        limits=(float(low), float(high)),
    )


def _half_sizes(model: mujoco.MjModel, geom: int) -> np.ndarray:
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    if kind == _BOX:
        return size
    if kind == _SPHERE:
        return np.full(3, size[0])
    if kind in (_CAPSULE, _CYLINDER):
        return np.array([size[0], size[0], size[1] + (size[0] if kind == _CAPSULE else 0.0)])
    return np.array(model.geom_aabb[geom, 3:])
