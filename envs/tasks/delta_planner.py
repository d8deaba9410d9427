"""Planner that follows another one's joint targets by deltas from where the arm is, one action at a time."""

from dataclasses import dataclass

import numpy as np
import torch

from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.delta_controllers import JointDeltaController, PoseDeltaController
from envs.tasks.planner import Planner

FASTEST = 0.9
"""Share of the largest action that a path uses: the rest is for errors."""

LAG_RAD, NEAR_RAD = 0.05, 0.01
"""The path waits where a joint is farther behind; the second where fingers begin to move, and at its end."""

MOST_WAITED = 8
"""Steps after which the path goes on all the same."""

FINGERS_M = 1e-4
"""Difference of targets of a finger that is a movement."""

MOST_EPISODES = 4096
"""Episodes whose paths are kept, the newest: more than run at once."""


@dataclass(slots=True)
class _Followed:
    """A path of joint targets (T, D), the place on it, and how long the arm has been waited for."""

    targets: np.ndarray
    place: int = 0
    waited: int = 0


class DeltaPlanner:
    """Follows joint targets; the path of an episode is kept under the episode's generator.

    Args:
        planner: Plans joint targets, rad and m.
        controller: Turns them into actions.
        robot: The robot of both.
    """

    def __init__(
        self, planner: Planner, controller: JointDeltaController | PoseDeltaController, robot: RobotCfg
    ) -> None:
        self._planner, self._controller, self._robot = planner, controller, robot.name
        driven = list(robot.driven)
        self._arm, self._arm_targets = list(robot.arm), [driven.index(column) for column in robot.arm]
        self._fingers = [driven.index(column) for column in robot.fingers if column in driven]
        self._followed: dict[int, tuple[np.random.Generator, _Followed]] = {}

    def plan(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns the next action (1, A) float32, or none; see :class:`envs.tasks.planner.Planner`."""
        _, followed = self._followed.get(id(rng), (rng, None))
        if followed is None or self._moved_on(followed, state):
            targets = self._planner.plan(state, rng)
            if not len(targets):
                return np.zeros((0, len(self._controller.names)), np.float32)
            followed = _Followed(self._slowed(targets))
            self._keep(rng, followed)
        return self._controller.towards(state, torch.from_numpy(followed.targets[followed.place][None]))

    def _slowed(self, targets: np.ndarray) -> np.ndarray:
        """Returns joint targets (T', D) that are no farther apart than an action goes, on the same path."""
        steps = np.maximum(np.ceil(self._controller.lengths(targets) / FASTEST), 1.0)
        times = np.concatenate([[0.0], np.cumsum(steps)])
        even = np.arange(times[-1] + 1.0)
        return np.stack([np.interp(even, times, column) for column in targets.T], 1)

    def _keep(self, rng: np.random.Generator, followed: _Followed) -> None:
        """Keeps a path under its generator, which is kept too, so that no other has its identity."""
        self._followed.pop(id(rng), None)
        self._followed[id(rng)] = (rng, followed)
        if len(self._followed) > MOST_EPISODES:
            del self._followed[next(iter(self._followed))]

    def _moved_on(self, followed: _Followed, state: State) -> bool:
        """Goes on to the next place, if the arm is near enough; returns whether the path is over."""
        targets, place = followed.targets, followed.place
        joints = state.robots[self._robot].joint_pos[0, self._arm].cpu().numpy()
        behind = float(np.abs(targets[place, self._arm_targets] - joints).max())
        last = place + 1 == len(targets)
        fingers = targets[:, self._fingers]
        begins = not last and np.abs(fingers[place + 1] - fingers[place]).max() > FINGERS_M
        begins = begins and (place == 0 or np.abs(fingers[place] - fingers[place - 1]).max() <= FINGERS_M)
        if behind > (NEAR_RAD if last or begins else LAG_RAD) and followed.waited < MOST_WAITED:
            followed.waited += 1
            return False
        followed.waited = 0
        followed.place = place if last else place + 1
        return last
