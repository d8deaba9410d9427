"""PushT, after ManiSkill 3 (``tabletop/push_t.py``), which follows Diffusion Policy (arXiv:2303.04137).

ManiSkill counts the pixels of an image of the goal, 64 along 0.3 m, that the block covers; here cells of 5 mm
are counted in which both are. The reward is ManiSkill's dense one.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import Array, concatenate, constant, norm
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA_STICK
from envs.rotations import yaw_of
from envs.scenario import CameraCfg, GeomCfg, ObjectCfg, Rgba, RobotCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start, heading, point, way
from envs.tasks.maniskill.parts import GOAL_Z_M
from envs.tasks.maniskill.tee_pushes import BARS, STICK_ROOM_M, best_push
from envs.tasks.skills.from_above import slide
from envs.tasks.tabletop import FRONT_CAMERA, distance, ee_pos, nearness

HALF_THICKNESS_M = 0.02
MASS_KG = 0.8
FRICTION = (1.65, 0.005, 0.0001)
"""ManiSkill has 3 for the block and 0.3 for table and stick; PhysX takes the mean, MuJoCo the larger."""

RED: Rgba = (194 / 255, 19 / 255, 22 / 255, 1.0)
GREY: Rgba = (128 / 255, 128 / 255, 128 / 255, 1.0)

END_POS_M = (-0.321, 0.284)
"""Where the stick starts; Diffusion Policy asks it to end on the disc there, ManiSkill does not."""

HOME = (0.662, 0.212, 0.086, -2.685, -0.115, 2.898, 1.673)

CELL_M = 0.005
TRAVEL_Z_M, PUSH_Z_M = 0.07, 0.009
"""Heights of the stick's end between pushes and in them: pushed higher up, the block would tip."""

PUSH_M_S = 0.12
"""Speed of the stick in a push; friction stops the block at once."""


def _cells() -> np.ndarray:
    """Returns the middles of the cells of the T, in its frame, m, (K, 2)."""
    parts = []
    for middle, half in BARS:
        counts = [round(2 * side / CELL_M) for side in half]
        x, y = (
            (np.arange(count) + 0.5) * CELL_M - side + at
            for count, side, at in zip(counts, half, middle, strict=True)
        )
        parts.append(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    return np.concatenate(parts)


_CELLS = _cells()


def _tee(half_thickness_m: float, rgba: Rgba, mass_kg: float) -> tuple[GeomCfg, ...]:
    areas = [half[0] * half[1] for _, half in BARS]
    return tuple(
        GeomCfg(
            shape="box",
            size=(*half, half_thickness_m),
            pos=(*middle, 0.0),
            rgba=rgba,
            mass_kg=mass_kg * area / sum(areas),
            friction=FRICTION,
        )
        for (middle, half), area in zip(BARS, areas, strict=True)
    )


@dataclass(frozen=True, kw_only=True)
class PushT(ArmAtTable):
    """Push the T onto its outline.

    Attributes:
        goal_m: Place of the outline.
        goal_yaw_rad: Its turn about z.
        spawn_offset_x_m: Range of the block's start along x, from the outline.
        spawn_offset_y_m: Range along y.
        covered: Least share of the outline that the block covers.
    """

    name: ClassVar[str] = "PushT"
    instructions: ClassVar[tuple[str, ...]] = (
        "push the red T onto its grey outline",
        "slide the T-shaped block until it covers the target",
        "align the T with the grey T on the table by pushing it with the stick",
    )
    max_episode_steps: ClassVar[int] = 1000
    own_robot: ClassVar[RobotCfg] = replace(FRANKA_STICK, pos=(-0.615, 0.0, 0.0)).with_home(HOME)
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(0.35, 0.0, 0.75), look_at=(-0.2, 0.0, 0.0), fovy_deg=46.0
    )

    goal_m: tuple[float, float] = (-0.156, -0.1)
    goal_yaw_rad: float = 5.0 / 3.0 * np.pi
    spawn_offset_x_m: tuple[float, float] = (-0.1, 0.1)
    spawn_offset_y_m: tuple[float, float] = (-0.1, 0.2)
    covered: float = 0.9

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        disc = GeomCfg(shape="cylinder", size=(0.02, 2e-4), rgba=GREY)
        return (
            ObjectCfg(
                name="tee", geoms=_tee(HALF_THICKNESS_M, RED, MASS_KG), pos=(0.0, 0.0, HALF_THICKNESS_M)
            ),
            ObjectCfg(name="goal", geoms=_tee(2e-4, GREY, 0.0), pos=(*self.goal_m, GOAL_Z_M), kind="marker"),
            ObjectCfg(name="end", geoms=(disc,), pos=(*END_POS_M, GOAL_Z_M), kind="marker"),
        )

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        x = self.goal_m[0] + rng.uniform(*self.spawn_offset_x_m)
        y = self.goal_m[1] + rng.uniform(*self.spawn_offset_y_m)
        return {
            "tee": Start((x, y, HALF_THICKNESS_M), rng.uniform(0.0, 2 * np.pi)),
            "goal": Start((*self.goal_m, GOAL_Z_M), self.goal_yaw_rad),
        }

    @override
    def success(self, state: State) -> Tensor:
        return self.overlap(state) >= self.covered

    def overlap(self, state: State) -> Array:
        """Returns the share of the outline that the block covers, (N,)."""
        tee, goal = state.objects["tee"], state.objects["goal"]
        cells = _CELLS if isinstance(tee.pos, np.ndarray) else tee.pos.new_tensor(_CELLS)
        places = _turned(cells[None], yaw_of(goal.rot)[:, None]) + goal.pos[:, None, :2]
        inside = _turned(places - tee.pos[:, None, :2], -yaw_of(tee.rot)[:, None])
        found = inside[..., 0] > np.inf
        for middle, half in BARS:
            near = abs(inside - constant(middle, inside)) <= constant(half, inside)
            found = found | (near[..., 0] & near[..., 1])
        return found.sum(-1) / len(_CELLS)

    @override
    def reward(self, state: State) -> Tensor:
        """Returns ManiSkill's: nearness of turn and place, and of the stick to the block; over 3."""
        tee, goal = state.objects["tee"], state.objects["goal"]
        turned = _cosine(yaw_of(tee.rot) - yaw_of(goal.rot))
        placed = nearness(norm(tee.pos[:, :2] - goal.pos[:, :2]))
        reached = nearness(distance(tee.pos, ee_pos(self.arm(state))))
        return (((turned + 1.0) / 2.0) ** 2 / 2.0 + placed**2 / 2.0 + reached**0.5 / 20.0) / 3.0

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the block's pose, its goal, the stick's end, and ways between them, (N, 19)."""
        tee, goal, tip = state.objects["tee"], state.objects["goal"], ee_pos(self.arm(state))
        return concatenate((tee.pos, tee.rot, goal.pos, tip, tee.pos - tip, goal.pos - tee.pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        """Returns one push; the next one is planned from where the block is then.

        Which push brings the block nearest to its goal is for :mod:`envs.tasks.maniskill.tee_pushes` to say.
        """
        tee, tip = state.objects["tee"], ee_pos(self.arm(state))[0].numpy()
        push = best_push(point(tee)[:2], heading(tee), np.array(self.goal_m), self.goal_yaw_rad)
        touching = push.point + (STICK_ROOM_M - 0.002) * push.normal
        # Beside the side first, then against it along the push.
        start = touching + (0.004 + rng.uniform(0.0, 0.004)) * push.normal
        end = touching + push.length_m * push.direction
        up, over = np.array([tip[0], tip[1], TRAVEL_Z_M]), np.array([*start, TRAVEL_Z_M])
        come = way(over, 0.0, 0.0, 0.2 + 2.0 * float(np.linalg.norm(over - up)), hold_s=0.15)
        places = [np.array([*place, PUSH_Z_M]) for place in (start, touching, end)]
        return [
            way(up, 0.0, 0.0, 0.1 + 4.0 * abs(TRAVEL_Z_M - float(tip[2]))),
            come,
            *slide(come, places, (0.35, 0.15, 0.2 + push.length_m / PUSH_M_S), hold_s=0.15),
        ]


def _turned(vectors: Array, angle: Array) -> Array:
    """Returns vectors (..., 2) of the plane turned by angles (...,), rad."""
    cosine, sine = _cosine(angle), _cosine(angle - np.pi / 2)
    x, y = vectors[..., 0], vectors[..., 1]
    parts = (cosine * x - sine * y, sine * x + cosine * y)
    return concatenate([part[..., None] for part in parts])


def _cosine(angle: Array) -> Array:
    return np.cos(angle) if isinstance(angle, np.ndarray) else angle.cos()
