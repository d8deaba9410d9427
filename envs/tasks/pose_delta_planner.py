"""Planner that follows the waypoints of a task's expert by pose deltas, looking at the hand in every step."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from envs.kinematics.batched_inverse import BatchedInverseKinematics
from envs.kinematics.waypoints import Path, Waypoint, interpolate
from envs.operational_space import DELTA_M, DELTA_RAD
from envs.rotations import conjugate, from_euler, from_matrix, multiply, to_euler
from envs.scenario import ScenarioCfg
from envs.state import State
from envs.tasks.waypoint_planner import Expert

LAG_M, LAG_RAD = 0.03, 0.3
"""The path waits where the hand is farther behind: at 0.15 m/s it is 2.5 cm behind."""

NEAR_M, NEAR_RAD = 0.004, 0.05
"""The fingers move, and a path ends, once the hand is this near, or after :data:`MOST_WAITED` steps."""

MOST_WAITED = 20

FINGERS_M = 0.004
"""Difference of a finger's target from the wanted one at which the fingers have arrived."""

MOST_EPISODES = 4096
"""Episodes whose paths are kept, the newest: more than run at once."""


@dataclass(slots=True)
class _Followed:
    """A path, the place on it, and how long the hand has been waited for."""

    path: Path
    rots: np.ndarray
    place: int = 0
    waited: int = 0


class PoseDeltaPlanner:
    """Follows an expert's waypoints with :class:`~envs.operational_space.OperationalSpaceController`.

    A plan is one action: its deltas are from where the hand is. The path of an episode is kept under the
    episode's generator, so that episodes do not depend on each other.

    Args:
        scenario: The scene, with the robot of the controller.
        expert: Returns waypoints for a state of one row.
    """

    def __init__(self, scenario: ScenarioCfg, expert: Expert) -> None:
        self._expert, self._robot = expert, scenario.robots[0]
        self._control_hz = scenario.physics.control_hz
        self._down = from_matrix(BatchedInverseKinematics(self._robot).upright).numpy()
        self._finger = list(self._robot.driven).index(self._robot.fingers[0])
        self._followed: dict[int, tuple[np.random.Generator, _Followed]] = {}

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next action (1, 7) float32, or none; see :class:`envs.tasks.planner.Planner`."""
        robot = state.robots[self._robot.name]
        assert robot.ee_pos is not None and robot.ee_rot is not None and robot.joint_target is not None
        pos, rot = robot.ee_pos[0].cpu().numpy(), robot.ee_rot[0].cpu().numpy()
        opening = float(robot.joint_target[0, self._finger])
        _, followed = self._followed.get(id(rng), (rng, None))
        if followed is None or self._moved_on(followed, pos, rot, opening):
            waypoints = self._expert(state, rng)
            if not waypoints:
                return np.zeros((0, 7), np.float32)
            followed = self._begun(pos, rot, waypoints)
            self._keep(rng, followed)
        path, place = followed.path, followed.place
        action = np.zeros(7)
        action[:3] = (path.pos[place] - pos) / DELTA_M
        action[3:6] = _turn(rot, followed.rots[place]) / DELTA_RAD
        action[6] = self._gripper(float(path.gripper[place]), opening)
        return np.clip(action, -1.0, 1.0)[None].astype(np.float32)

    def _keep(self, rng: np.random.Generator, followed: _Followed) -> None:
        """Keeps a path under its generator, which is kept too, so that no other has its identity."""
        self._followed.pop(id(rng), None)
        self._followed[id(rng)] = (rng, followed)
        if len(self._followed) > MOST_EPISODES:
            del self._followed[next(iter(self._followed))]

    def _begun(self, pos: np.ndarray, rot: np.ndarray, waypoints: Sequence[Waypoint]) -> _Followed:
        yaw, pitch, roll = to_euler(multiply(rot, conjugate(self._down)))
        first = Waypoint(pos=pos, yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0)
        path = interpolate(first, waypoints, self._control_hz)
        return _Followed(path, multiply(from_euler(path.turn), self._down))

    def _moved_on(self, followed: _Followed, pos: np.ndarray, rot: np.ndarray, opening: float) -> bool:
        """Continues to the next place, if the hand is near enough; returns whether the path is over."""
        path, place = followed.path, followed.place
        off_m = float(np.linalg.norm(path.pos[place] - pos))
        off_rad = float(np.linalg.norm(_turn(rot, followed.rots[place])))
        last = place + 1 == len(path.pos)
        changes = not last and path.gripper[place + 1] != path.gripper[place]
        near = off_m < NEAR_M and off_rad < NEAR_RAD
        arrived = abs(np.clip(path.gripper[place], 0.0, self._robot.opening_m / 2) - opening) < FINGERS_M
        ready = (near if last or changes else off_m < LAG_M and off_rad < LAG_RAD) and arrived
        if not ready and followed.waited < MOST_WAITED:
            followed.waited += 1
            return False
        followed.waited = 0
        followed.place = place if last else place + 1
        return last

    def _gripper(self, wanted_m: float, opening_m: float) -> float:
        """Returns the action that brings the fingers' targets to a distance from the middle."""
        if wanted_m <= FINGERS_M:
            return 1.0
        if wanted_m >= self._robot.opening_m / 2 - FINGERS_M:
            return -1.0
        return 0.0 if abs(wanted_m - opening_m) < FINGERS_M else float(np.sign(opening_m - wanted_m))


def _turn(now: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Returns the rotation vector (3,), rad, in the world, from one orientation to another, both wxyz."""
    turn = multiply(wanted, conjugate(now))
    turn = turn if turn[0] >= 0.0 else -turn
    sine = float(np.linalg.norm(turn[1:]))
    return turn[1:] * (2.0 * np.arctan2(sine, turn[0]) / max(sine, 1e-12))
