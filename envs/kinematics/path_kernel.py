"""Following paths on a GPU: one kernel for all control steps, with a thread for every path.

In torch a step of :class:`~envs.kinematics.batched_inverse.BatchedInverseKinematics` is some 60 kernels of a
few µs, and hundreds of steps follow each other: their launches take far longer than the arithmetic.

Shapes: N paths, T control steps, K joints between the world and the end effector. All numbers are float64.
"""

# Kernels are in Warp's dialect: types are values, and its stubs lack operators of vectors and matrices.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false

import functools
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from envs.kinematics.forward import KinematicChain
from envs.start_warp import start_warp

BLOCK_SIZE = 32
"""Threads of a block: few, so that some hundred paths are spread over all multiprocessors."""

_ZERO, _HALF, _ONE = (wp.constant(wp.float64(value)) for value in (0.0, 0.5, 1.0))
_TINY = wp.constant(wp.float64(1e-9))
_Six: Any = wp.types.vector(length=6, dtype=wp.float64)


@dataclass(frozen=True, kw_only=True, slots=True)
class Costs:
    """What :meth:`envs.kinematics.batched_inverse.BatchedInverseKinematics.change` makes small.

    Attributes:
        rest: The posture that decides what the end effector leaves open, (K,) rad.
        errors: Weights of the squared errors in position and orientation, (6,).
        damping: Least of the damping, and how it grows with the squared error.
        posture: Weight of the pull towards ``rest``.
        fixed: Weight that holds a joint at its limit.
    """

    rest: Tensor
    errors: Tensor
    damping: float
    posture: float
    fixed: float


class PathKernel:
    """Follows paths as :class:`~envs.kinematics.batched_inverse.BatchedPathFollower` does.

    Args:
        chain: Forward kinematics; its device is where the kernel runs.
        costs: What each step makes small.

    Raises:
        RuntimeError: The kernel cannot be compiled.
    """

    def __init__(self, chain: KinematicChain, costs: Costs) -> None:
        start_warp()
        count = len(costs.rest)
        self._device = wp.device_from_torch(costs.rest.device)
        self._kernel, joints = _kernel_of(count)
        block_size = BLOCK_SIZE if self._device.is_cuda else None
        wp.load_module(self._kernel.module, self._device, block_dim=block_size)
        *mats, site, axis, anchor, hinge = chain.constants
        arrays = [(value, wp.mat44d) for value in mats] + [(axis, wp.vec3d), (anchor, wp.vec3d)]
        self._kept = [value.contiguous() for value, _ in arrays]  # the arrays share their memory
        self._constants = [
            *(wp.from_torch(value, dtype=kind) for value, (_, kind) in zip(self._kept, arrays, strict=True)),
            wp.mat44d(*site.flatten().tolist()),
            *(joints(*value.tolist()) for value in (hinge, chain.low, chain.high, costs.rest)),
            _Six(*costs.errors.tolist()),
            wp.vec3d(costs.damping, costs.posture, costs.fixed),
        ]

    def __call__(self, q: Tensor, pos: Tensor, rot: Tensor, iterations: int) -> Tensor:
        """Returns postures (N, T, K) that reach the poses in turn.

        Args:
            q: Where the paths start, (N, K).
            pos: Positions, m, (N, T, 3).
            rot: Orientations, (N, T, 3, 3).
            iterations: Differential steps per control step.
        """
        out = q.new_empty((*pos.shape[:2], q.shape[-1]))
        q, pos, rot = q.contiguous(), pos.contiguous(), rot.contiguous()
        wp.launch(
            self._kernel,
            dim=len(q),
            inputs=[
                *self._constants,
                wp.from_torch(q),
                wp.from_torch(pos, dtype=wp.vec3d),
                wp.from_torch(rot, dtype=wp.mat33d),
                iterations,
            ],
            outputs=[wp.from_torch(out)],
            device=self._device,
            stream=wp.stream_from_torch(torch.cuda.current_stream(q.device)) if q.is_cuda else None,
            block_dim=BLOCK_SIZE,
        )
        return out


@functools.cache
def _kernel_of(count: int) -> tuple[Any, Any]:
    """Returns the kernel for chains of ``count`` joints, and the type of their postures."""
    joints: Any = wp.types.vector(length=count, dtype=wp.float64)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def follow(
        fixed: wp.array(dtype=wp.mat44d),
        first: wp.array(dtype=wp.mat44d),
        second: wp.array(dtype=wp.mat44d),
        axis: wp.array(dtype=wp.vec3d),
        anchor: wp.array(dtype=wp.vec3d),
        site: wp.mat44d,
        hinge: joints,
        low: joints,
        high: joints,
        rest: joints,
        weights: _Six,
        numbers: wp.vec3d,
        start: wp.array2d(dtype=wp.float64),
        pos: wp.array2d(dtype=wp.vec3d),
        rot: wp.array2d(dtype=wp.mat33d),
        iterations: int,
        out: wp.array3d(dtype=wp.float64),
    ):
        path = wp.tid()
        q = joints()
        for k in range(count):
            q[k] = start[path, k]
        for step in range(pos.shape[1]):
            for _ in range(iterations):
                end, jacobian = _kinematics(q, hinge, fixed, first, second, axis, anchor, site)
                error = _error(end, pos[path, step], rot[path, step])
                q = q + _change(q, error, jacobian, low, high, rest, weights, numbers)
            q = wp.min(wp.max(q, low), high)
            for k in range(count):
                out[path, step, k] = q[k]

    return follow, joints


@wp.func
def _kinematics(
    q: Any,
    hinge: Any,
    fixed: wp.array(dtype=wp.mat44d),
    first: wp.array(dtype=wp.mat44d),
    second: wp.array(dtype=wp.mat44d),
    axis: wp.array(dtype=wp.vec3d),
    anchor: wp.array(dtype=wp.vec3d),
    site: wp.mat44d,
):
    """Returns the end effector's pose (4, 4) and Jacobian (6, K): see KinematicChain."""
    frame = wp.identity(n=4, dtype=wp.float64)
    points = wp.outer(wp.vec3d(), q)
    axes = wp.outer(wp.vec3d(), q)
    for k in range(len(q)):
        sine = wp.where(hinge[k] > _HALF, wp.sin(q[k]), q[k])
        frame = frame @ (fixed[k] + sine * first[k] + wp.cos(q[k]) * second[k])
        turned = wp.transform_vector(frame, axis[k])
        point = wp.transform_point(frame, anchor[k])
        for row in range(3):
            points[row, k] = point[row]
            axes[row, k] = turned[row]
    end = frame @ site
    at = wp.vec3d(end[0, 3], end[1, 3], end[2, 3])
    jacobian = wp.outer(_Six(), q)
    for k in range(len(q)):
        turned = wp.vec3d(axes[0, k], axes[1, k], axes[2, k])
        swing = wp.cross(turned, at - wp.vec3d(points[0, k], points[1, k], points[2, k]))
        for row in range(3):
            jacobian[row, k] = wp.where(hinge[k] > _HALF, swing[row], turned[row])
            jacobian[row + 3, k] = hinge[k] * turned[row]
    return end, jacobian


@wp.func
def _error(end: wp.mat44d, pos: wp.vec3d, rot: wp.mat33d):
    """Returns the way to a pose and the rotation vector to it, (6,): see rotation_vector."""
    now = wp.mat33d(
        end[0, 0], end[0, 1], end[0, 2], end[1, 0], end[1, 1], end[1, 2], end[2, 0], end[2, 1], end[2, 2]
    )  # fmt: skip
    turn = rot @ wp.transpose(now)
    skew = wp.vec3d(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    sine = _HALF * wp.length(skew)
    angle = wp.atan2(sine, _HALF * (wp.trace(turn) - _ONE))
    skew = wp.where(sine > _TINY, angle / wp.max(sine, _TINY), _ONE) * _HALF * skew
    return _Six(pos[0] - end[0, 3], pos[1] - end[1, 3], pos[2] - end[2, 3], skew[0], skew[1], skew[2])


@wp.func
def _change(
    q: Any, error: _Six, jacobian: Any, low: Any, high: Any, rest: Any, weights: _Six, numbers: wp.vec3d
):
    """Returns a step of Levenberg and Marquardt inside the limits: see BatchedInverseKinematics.change."""
    weighted = wp.cw_mul(weights, error)
    hessian = wp.outer(q, q)
    for i in range(len(q)):
        for j in range(len(q)):
            total = wp.float64(0.0)
            for row in range(6):
                total += weights[row] * jacobian[row, i] * jacobian[row, j]
            hessian[i, j] = total
    gradient = wp.transpose(jacobian) @ weighted + numbers[1] * (rest - q)
    damping = numbers[0] + numbers[0] * wp.dot(weighted, error) + numbers[1]
    change = _solved(hessian, damping, gradient - gradient, gradient)
    inside = wp.min(wp.max(change, low - q), high - q)
    stuck = change - change
    for i in range(len(q)):
        if inside[i] != change[i]:
            stuck[i] = _ONE
    if wp.length_sq(stuck) > _HALF:
        held = wp.cw_mul(stuck, inside)
        gradient = gradient - hessian @ held
        for i in range(len(q)):
            gradient[i] = (_ONE - stuck[i]) * gradient[i]
        change = _solved(hessian, damping, numbers[2] * stuck, gradient)
        for i in range(len(q)):
            change[i] = wp.where(stuck[i] > _HALF, held[i], change[i])
        change = wp.min(wp.max(change, low - q), high - q)
    return change


@wp.func
def _solved(matrix: Any, damping: wp.float64, extra: Any, right: Any):
    """Returns x with (matrix + damping + diag(extra)) x = right, by Cholesky's factor (K, K)."""
    factor = matrix
    x = right
    for i in range(len(right)):
        factor[i, i] = factor[i, i] + damping + extra[i]
    for i in range(len(right)):
        for j in range(i + 1):
            total = factor[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = wp.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(len(right)):
        for k in range(i):
            x[i] = x[i] - factor[i, k] * x[k]
        x[i] = x[i] / factor[i, i]
    for back in range(len(right)):
        i = len(right) - 1 - back
        for k in range(i + 1, len(right)):
            x[i] = x[i] - factor[k, i] * x[k]
        x[i] = x[i] / factor[i, i]
    return x
