"""Poses of what a hand moves relative to: objects, and moving parts of articulated ones.

A part is called ``object/part``, by the name of its joint. Its frame is that of the moving body, not of the
object's root: a lid that is half open is approached where it is.
"""

from functools import cached_property

import numpy as np

from envs.core.errors import unknown_name
from envs.kinematics.tree import TreeBody, TreeJoint, joints_of, path_to
from envs.mjcf.model import build_model
from envs.rotations import from_matrix, to_matrix
from envs.scenario import ObjectCfg, ScenarioCfg
from envs.state import State
from roboverse_learn.data.augmentation.pose import Pose


class References:
    """The objects and parts of a scenario.

    Args:
        scenario: The scene.

    Attributes:
        objects: Names of its objects.
        parts: Names of its parts to object and column of the object's joints.
    """

    def __init__(self, scenario: ScenarioCfg) -> None:
        self._configs = {item.name: item for item in scenario.objects}
        self.objects = tuple(self._configs)
        self.parts: dict[str, tuple[str, int]] = {
            f"{item.name}/{joint}": (item.name, column)
            for item in scenario.objects
            for column, joint in enumerate(item.joint_names)
        }

    @property
    def movable(self) -> tuple[str, ...]:
        """Names of the objects that physics moves."""
        return tuple(name for name, item in self._configs.items() if item.kind == "free")

    def pose(self, state: State, name: str) -> Pose:
        """Returns where a reference is in N states, (N,).

        Raises:
            UnknownNameError: The scene has no such object or part.
        """
        if name not in self.objects and name not in self.parts:
            raise unknown_name("object or part", name, (*self.objects, *self.parts))
        entity = state.objects[name.partition("/")[0]]
        root = Pose(entity.pos.cpu().numpy(), entity.rot.cpu().numpy())
        if name in self.objects:
            return root
        inner = self._chains[name].frames(entity.joint_pos.cpu().numpy())
        return root @ Pose(inner[:, :3, 3], from_matrix(inner[:, :3, :3]))

    @cached_property
    def _chains(self) -> "dict[str, _Chain]":
        """The parts' kinematics; compiling an object takes a moment, so only where it has parts."""
        return {
            f"{item.name}/{joint}": _Chain(item, joint)
            for item in self._configs.values()
            for joint in item.joint_names
        }


class _Chain:
    """The bodies from an object's root to one of its parts."""

    def __init__(self, item: ObjectCfg, joint: str) -> None:
        model = build_model(ScenarioCfg(robots=(), objects=(item,), table=None, room=None))
        columns = {
            int(model.joint(f"{item.name}/{name}").qposadr[0]): column
            for column, name in enumerate(item.joint_names)
        }
        path = path_to(model, int(model.joint(f"{item.name}/{joint}").bodyid[0]))
        root = [body.index for body in path].index(model.body(item.name).id)
        self._steps: list[tuple[TreeBody, list[tuple[TreeJoint, int | None]]]] = [
            (body, [(each, columns.get(each.qpos)) for each in joints_of(model, body.index)])
            for body in path[root + 1 :]
        ]

    def frames(self, joint_pos: np.ndarray) -> np.ndarray:
        """Returns the part in the root's frame, (N, 4, 4), from joint positions (N, J)."""
        frame = np.tile(np.eye(4), (len(joint_pos), 1, 1))
        for body, joints in self._steps:
            frame = frame @ body.frame
            for joint, column in joints:
                values = np.full(len(joint_pos), joint.rest) if column is None else joint_pos[:, column]
                frame = frame @ _transforms(joint, values)
        return frame


def _transforms(joint: TreeJoint, values: np.ndarray) -> np.ndarray:
    """Returns a joint's transforms (N, 4, 4) at positions (N,)."""
    first = np.sin(values) if joint.is_hinge else values
    second = np.cos(values) if joint.is_hinge else np.zeros_like(values)
    return joint.fixed + first[:, None, None] * joint.first + second[:, None, None] * joint.second


def in_frame(frame: Pose, points: np.ndarray) -> np.ndarray:
    """Returns world points (N, 3) in the frames (N,)."""
    return np.einsum("tji,tj->ti", to_matrix(frame.rot), points - frame.pos)
