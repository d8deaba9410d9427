"""Joint targets for many paths of the end effector at once, by damped least squares in torch.

The objective is that of :mod:`envs.kinematics.inverse` (mink, a QP per posture): position, orientation,
posture and damping with the same weights. The box of the joint limits is met by fixing the joints that would
leave it and solving for the others once more, instead of by a QP solver.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from envs.kinematics.forward import KinematicChain, Poses, rotation_vector
from envs.kinematics.waypoints import Path, Waypoint, interpolate
from envs.rotations import conjugate, from_euler, from_matrix, multiply, to_euler, to_matrix
from envs.scenario import RobotCfg

if TYPE_CHECKING:
    from envs.kinematics.path_kernel import PathKernel

logger = logging.getLogger(__name__)

ITERATIONS_PER_STEP = 3
"""Differential steps per control step; a path of 5 cm per step is then followed within 1 mm."""

DAMPING = 1e-3
ORIENTATION_COST = 0.3
"""Metres that a radian is worth: 1° is as bad as 5 mm."""

POSTURE_COST = 5e-3
"""Pull towards the rest posture, which decides what the end effector leaves open."""

_FIXED = 1e6
"""Weight that holds a joint at its limit; the others' are below 10."""


@dataclass(frozen=True, slots=True)
class BatchedTargets:
    """Joint targets of N paths.

    Attributes:
        targets: (N, T, J) float64 on the follower's device; beyond a path's end, its last pose is held.
        lengths: How many rows of each path count, (N,).
    """

    targets: Tensor
    lengths: np.ndarray

    def each(self) -> list[np.ndarray]:
        """Returns every path's targets, (T, J), without what it holds beyond its end."""
        rows = self.targets.cpu().numpy()
        return [row[:length] for row, length in zip(rows, self.lengths.tolist(), strict=True)]


class BatchedInverseKinematics:
    """Joint displacements that bring end effectors to their targets.

    Shapes: N postures, K joints between the world and the end effector.

    Args:
        robot: The robot.
        device: Where to compute.

    Attributes:
        chain: Forward kinematics.
        rest: The posture that decides what the end effector leaves open, (K,) rad.
        upright: Orientation of the end effector at rest, (3, 3).
    """

    def __init__(self, robot: RobotCfg, device: torch.device | str = "cpu") -> None:
        self.chain = KinematicChain(robot, device)
        rest = torch.tensor(robot.default_qpos, dtype=torch.float64, device=device)
        self.rest = rest[self.chain.columns]
        self.upright = self.chain(self.rest[None]).rot[0]
        costs = torch.tensor([1.0] * 3 + [ORIENTATION_COST] * 3, dtype=torch.float64, device=device)
        self._weights = costs.square()

    def change(self, q: Tensor, now: Poses, pos: Tensor, rot: Tensor) -> Tensor:
        """Returns the change (N, K) of the postures ``q`` (N, K) towards the targets, inside the limits.

        It is one step of Gauss and Newton: the way to a target 5 cm away is met within a few mm.

        Args:
            q: Postures, float64.
            now: What the chain makes of them.
            pos: Positions to reach, m, (N, 3).
            rot: Orientations to reach, (N, 3, 3).
        """
        chain = self.chain
        error = torch.cat([pos - now.pos, rotation_vector(rot @ now.rot.transpose(1, 2))], -1)  # (N, 6)
        weighted = now.jacobian.transpose(1, 2) * self._weights  # (N, K, 6)
        # Levenberg-Marquardt: the farther away, the more damped.
        damping = DAMPING + DAMPING * (error.square() * self._weights).sum(-1, keepdim=True)
        hessian = weighted @ now.jacobian
        gradient = (weighted @ error[..., None])[..., 0] + POSTURE_COST**2 * (self.rest - q)
        diagonal = (damping + POSTURE_COST**2).expand_as(q)
        change = _solve(hessian, diagonal, gradient)
        inside = torch.minimum(torch.maximum(change, chain.low - q), chain.high - q)
        stuck = inside != change
        if not change.is_cuda and not stuck.any():  # where looking is cheaper than solving again
            return change
        # Those at their limits move there and no farther; the others make up for it.
        held = torch.where(stuck, inside, torch.zeros_like(inside))
        rest = gradient - (hessian @ held[..., None])[..., 0]
        free = _solve(hessian, diagonal + _FIXED * stuck, torch.where(stuck, torch.zeros_like(rest), rest))
        change = torch.where(stuck, inside, free)
        return torch.minimum(torch.maximum(change, chain.low - q), chain.high - q)

    def path_kernel(self) -> "PathKernel":
        """Returns the kernel that takes these steps along whole paths, loaded.

        Raises:
            RuntimeError: The kernel cannot be compiled.
        """
        from envs.kinematics.path_kernel import Costs, PathKernel

        costs = Costs(
            rest=self.rest, errors=self._weights, damping=DAMPING, posture=POSTURE_COST**2, fixed=_FIXED
        )
        return PathKernel(self.chain, costs)


class BatchedPathFollower:
    """Turns waypoints into joint targets, for as many paths at once as there are.

    On a GPU one kernel follows all paths (:mod:`envs.kinematics.path_kernel`).

    Args:
        robot: The robot; ``ee_site`` follows the paths, the gripper's joints follow ``gripper``.
        control_hz: Targets per second.
        device: Where to compute.
    """

    def __init__(self, robot: RobotCfg, control_hz: float, device: torch.device | str = "cpu") -> None:
        self._robot, self._control_hz = robot, control_hz
        self._device = torch.device(device)
        self._ik = BatchedInverseKinematics(robot, device)
        self._chain = self._ik.chain
        self._fingers = list(robot.fingers)
        self._down = from_matrix(self._ik.upright.cpu().numpy())

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float64, device=self._device)

    def end_effectors(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns positions (N, 3) and orientations (N, 4) of the end effectors of ``qpos`` (N, J)."""
        poses = self._chain(self._tensor(qpos[:, self._chain.columns]))
        return poses.pos.cpu().numpy(), from_matrix(poses.rot.cpu().numpy())

    def joint_targets(self, qpos: np.ndarray, waypoints: Sequence[Sequence[Waypoint]]) -> BatchedTargets:
        """Returns joint targets that lead each end effector from ``qpos`` (N, J) along its waypoints."""
        paths = self._paths(qpos, waypoints)
        lengths = np.array([len(path.pos) for path in paths])
        longest = int(lengths.max(initial=0))

        def padded(rows: list[np.ndarray]) -> Tensor:
            return self._tensor(np.stack([row[np.minimum(np.arange(longest), len(row) - 1)] for row in rows]))

        pos = padded([path.pos for path in paths])
        rot = padded([to_matrix(multiply(from_euler(path.turn), self._down)) for path in paths])
        start = self._tensor(qpos)
        targets = start[:, None].repeat(1, longest, 1)
        targets[..., self._chain.columns] = self._follow(start[:, self._chain.columns], pos, rot)
        targets[..., self._fingers] = padded([self._robot.finger_positions(path.gripper) for path in paths])
        return BatchedTargets(targets, lengths)

    def follow_poses(
        self, qpos: np.ndarray, pos: np.ndarray, rot: np.ndarray
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Returns joint targets that lead each end effector from ``qpos`` through a pose per control step.

        Args:
            qpos: Where they start, (N, J).
            pos: Positions in the world, m, (N, T, 3).
            rot: Orientations, wxyz, (N, T, 4).

        Returns:
            Targets (N, T, J), in which joints that do not move the end effector stay, and by how much each
            pose is missed, m and rad, (N, T); float64 on the follower's device.
        """
        start, columns = self._tensor(qpos), self._chain.columns
        goal_pos, goal_rot = self._tensor(pos), self._tensor(to_matrix(rot))
        targets = start[:, None].repeat(1, pos.shape[1], 1)
        targets[..., columns] = self._follow(start[:, columns], goal_pos, goal_rot)
        now = self._chain(targets[..., columns].flatten(0, 1))
        off = (now.pos - goal_pos.flatten(0, 1)).norm(dim=-1)
        turn = rotation_vector(goal_rot.flatten(0, 1) @ now.rot.transpose(1, 2)).norm(dim=-1)
        return targets, off.reshape(pos.shape[:2]), turn.reshape(pos.shape[:2])

    def _paths(self, qpos: np.ndarray, waypoints: Sequence[Sequence[Waypoint]]) -> list[Path]:
        starts, rots = self.end_effectors(qpos)
        paths = []
        for pos, rot, way in zip(starts, rots, waypoints, strict=True):
            yaw, pitch, roll = to_euler(multiply(rot, conjugate(self._down)))
            first = Waypoint(pos=pos, yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0)
            paths.append(interpolate(first, way, self._control_hz))
        return paths

    @torch.inference_mode()
    def _follow(self, q: Tensor, pos: Tensor, rot: Tensor) -> Tensor:
        """Returns postures (N, T, K) that reach ``pos`` (N, T, 3) and ``rot`` (N, T, 3, 3) in turn."""
        if self._kernel is not None:
            return self._kernel(q, pos, rot, ITERATIONS_PER_STEP)
        out = torch.empty((*pos.shape[:2], q.shape[-1]), dtype=q.dtype, device=q.device)
        for step in range(pos.shape[1]):
            for _ in range(ITERATIONS_PER_STEP):
                q = q + self._ik.change(q, self._chain(q), pos[:, step], rot[:, step])
            q = q.clamp(self._chain.low, self._chain.high)
            out[:, step] = q
        return out

    @cached_property
    def _kernel(self) -> "PathKernel | None":
        """One kernel for whole paths on a GPU; None on a CPU, and where it cannot be compiled."""
        if self._device.type != "cuda":
            return None
        try:
            return self._ik.path_kernel()
        except Exception as error:
            logger.warning("Paths are followed by torch, which is slower: %s", error)
            return None


def _solve(matrix: Tensor, diagonal: Tensor, right: Tensor) -> Tensor:
    """Solves (matrix + diag(diagonal)) x = right for symmetric, positive matrices (N, K, K)."""
    factor, _ = torch.linalg.cholesky_ex(matrix + torch.diag_embed(diagonal))
    return torch.cholesky_solve(right[..., None], factor)[..., 0]
