"""Position actuators whose force limit does not bound the damping of their joint."""

from collections.abc import Sequence

import numpy as np

from envs.mjcf.link_tree import JointSpec


class Servos:
    """Difference of PhysX's drives from position actuators with separate joint damping.

    A joint has one drive in PhysX, and its limit bounds the damping too; in MuJoCo the limit bounds the
    actuator, and the damping is added. The two are the same until an actuator reaches its limit, as those of
    a robot on legs often do: at 10 rad/s the H1's damping is a quarter of its ankles' limit and half of its
    elbows'. Where the base is fixed this is left out, for it costs some microseconds a step and changes
    little: at 1 rad/s a Franka's damping is 1 % of its wrist's limit.

    Args:
        joints: Joints in the articulation's order.
    """

    def __init__(self, joints: Sequence[JointSpec]) -> None:
        driven = np.array([spec.actuator >= 0 and not spec.takes_force for spec in joints], bool)
        self._driven = driven
        self._kp, self._kd, self._damping = (
            np.where(driven, [getattr(spec, name) for spec in joints], 0.0)
            for name in ("kp", "kd", "damping")
        )
        self._limit = np.array([spec.force_limit for spec in joints])
        self._actuators = np.array([spec.actuator for spec in joints], np.intp)[driven]
        self._target = np.zeros(len(joints))
        self._bounded = bool(np.any(np.isfinite(self._limit) & (self._damping > 0.0)))

    def __bool__(self) -> bool:
        return self._bounded

    def aim(self, ctrl: np.ndarray) -> None:
        """Takes the targets from the row."""
        self._target[self._driven] = ctrl[self._actuators]

    def missing(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Returns the forces to add to the drives', (J,)."""
        force, drag = self._kp * (self._target - qpos) - self._kd * qvel, self._damping * qvel
        low, high = -self._limit, self._limit
        return _bounded(force, low, high) - drag - _bounded(force - drag, low, high)


def _bounded(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(value, low), high)  # 2× faster than np.clip
