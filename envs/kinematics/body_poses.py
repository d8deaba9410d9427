"""Poses and velocities of all bodies of a robot, from its state alone, for N states at once.

Shapes: N states, B bodies. No simulator is involved, so rewards are the same on every simulator.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name
from envs.kinematics.tree import TreeBody, by_depth, joints_of
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.rotations import to_matrix
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import EntityState


@dataclass(frozen=True, slots=True)
class BodyStates:
    """Bodies of N robots, in the world.

    Attributes:
        pos: Positions of their frames, m, (N, B, 3).
        rot: Orientations, (N, B, 3, 3).
        lin_vel: Velocities of their frames' origins, m/s, (N, B, 3).
        ang_vel: Angular velocities, rad/s, (N, B, 3).
    """

    pos: Tensor
    rot: Tensor
    lin_vel: Tensor
    ang_vel: Tensor


@dataclass(frozen=True, slots=True)
class _Level:
    """The bodies of one depth of the tree; ``parents`` are indices among those of the depth before."""

    parents: Tensor
    offset: Tensor  # (b, 3), in the parent
    still: Tensor  # a hinge by q turns by still + sin q · sine + cos q · cosine, (b, 3, 3)
    sine: Tensor
    cosine: Tensor
    axis: Tensor  # (b, 3), in the body; zero where there is no joint
    columns: Tensor  # of joint_pos


class BodyTree:
    """A robot's bodies as constants of one recursion, depth by depth.

    Args:
        robot: A robot with a free base; each other body has one hinge at its origin, or none.
        device: Where to compute.
        dtype: In which precision.

    Attributes:
        names: Names of the bodies, without the robot's; the first is the root.
        masses: Masses, kg, (B,).
        coms: Centres of mass in the bodies' frames, m, (B, 3).

    Raises:
        ConfigError: if a body has another kind of joint, or several, or one that is not at its origin.
    """

    def __init__(
        self, robot: RobotCfg, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float64
    ) -> None:
        depths = _depths_of(robot)
        table = [row for depth in depths for row in depth]

        def stack(rows: "list[_Body]", name: str) -> Tensor:
            values = np.array([getattr(row, name) for row in rows])
            kind = torch.long if values.dtype.kind == "i" else dtype
            return torch.as_tensor(values, device=device).to(kind)

        self.names = tuple(row.name for row in table)
        self.masses, self.coms = stack(table, "mass"), stack(table, "com")
        self._shares = (self.masses / self.masses.sum())[:, None]
        fields = _Level.__dataclass_fields__  # type: ignore[attr-defined]
        self._levels = [_Level(**{name: stack(rows, name) for name in fields}) for rows in depths[1:]]

    def index(self, body: str) -> int:
        """Returns the index of a body."""
        if body not in self.names:
            raise unknown_name("body", body, self.names)
        return self.names.index(body)

    def __call__(self, robot: EntityState) -> BodyStates:
        """Returns where the bodies of a robot are, and how they move."""
        rot = to_matrix(robot.rot / torch.linalg.vector_norm(robot.rot, dim=-1, keepdim=True))[:, None]
        pos, lin_vel = robot.pos[:, None], robot.lin_vel[:, None]
        ang_vel = _turned(rot, robot.ang_vel[:, None])
        levels = [(pos, rot, lin_vel, ang_vel)]
        for level in self._levels:
            joint_pos = robot.joint_pos[:, level.columns, None, None]
            turn = level.still + torch.sin(joint_pos) * level.sine + torch.cos(joint_pos) * level.cosine
            up = level.parents
            arm = _turned(rot[:, up], level.offset)
            pos, lin_vel = pos[:, up] + arm, lin_vel[:, up] + torch.linalg.cross(ang_vel[:, up], arm)
            rot = rot[:, up] @ turn
            ang_vel = ang_vel[:, up] + _turned(rot, level.axis) * robot.joint_vel[:, level.columns, None]
            levels.append((pos, rot, lin_vel, ang_vel))
        return BodyStates(*(torch.cat(parts, dim=1) for parts in zip(*levels, strict=True)))

    def place(self, bodies: BodyStates, body: int, offset: tuple[float, float, float]) -> Tensor:
        """Returns where a point of a body is in the world, m, (N, 3)."""
        point = bodies.pos.new_tensor(offset)
        return bodies.pos[:, body] + bodies.rot[:, body] @ point

    def com_velocity(self, bodies: BodyStates) -> Tensor:
        """Returns the velocity of the whole robot's centre of mass, m/s, (N, 3)."""
        arms = _turned(bodies.rot, self.coms)
        speeds = bodies.lin_vel + torch.linalg.cross(bodies.ang_vel, arms)
        return (speeds * self._shares).sum(1)


def _turned(rot: Tensor, vectors: Tensor) -> Tensor:
    return (rot @ vectors[..., None])[..., 0]


@dataclass(frozen=True, slots=True)
class _Body:
    name: str
    parents: int
    mass: float
    com: np.ndarray
    offset: np.ndarray
    still: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    axis: np.ndarray
    columns: int


@lru_cache(maxsize=16)
def _depths_of(robot: RobotCfg) -> list[list[_Body]]:
    """Reads the tree from the compiled robot, depth by depth."""
    alone = replace(robot, feels=())  # the objects that it senses are not in this scene
    scenario = ScenarioCfg(robots=(alone,), table=None, room=None)
    model = build_model(scenario, simplify=False)
    layout = layout_of(model, scenario).robots[0]
    column_of = {int(address): column for column, address in enumerate(layout.qpos)}
    depths = by_depth(model, model.body(f"{robot.name}/{robot.root}").id)
    above = [[], *([body.index for body in depth] for depth in depths)]
    return [
        [_read(model, body, parents, column_of, robot) for body in depth]
        for depth, parents in zip(depths, above, strict=False)
    ]


def _read(
    model: mujoco.MjModel, body: TreeBody, parents: list[int], column_of: dict[int, int], robot: RobotCfg
) -> _Body:
    name = body.name.removeprefix(f"{robot.name}/")
    still, sine, cosine, axis, column = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), 0
    joints = joints_of(model, body.index) if parents else []
    if joints:
        joint = joints[0]
        if len(joints) > 1 or not joint.is_hinge:
            raise ConfigError(f"Body '{name}' of robot '{robot.name}' needs one hinge, or no joint at all.")
        if joint.anchor.any():
            raise ConfigError(f"The hinge of body '{name}' of robot '{robot.name}' is not at its origin.")
        axis, column = joint.axis, column_of[joint.qpos]
        still, sine, cosine = (part[:3, :3] for part in (joint.fixed, joint.first, joint.second))
    frame = body.frame[:3, :3]
    return _Body(
        name=name,
        parents=parents.index(body.parent) if parents else 0,
        mass=body.mass,
        com=body.com,
        offset=body.frame[:3, 3],
        still=frame @ still,
        sine=frame @ sine,
        cosine=frame @ cosine,
        axis=axis,
        columns=column,
    )
