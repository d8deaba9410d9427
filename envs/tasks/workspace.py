"""What a randomization channel asks of a task: contacts, the hand's place, the expert's way, its objects.

It follows from the scene and from a state alone, so that a start is the same in every simulator.
"""

from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
import torch

from envs.kinematics.forward import KinematicChain
from envs.rotations import from_matrix
from envs.scenario import RobotCfg
from envs.state import State
from envs.tasks.arm_contacts import ArmContacts
from envs.tasks.base import Task

STEP_M = 0.02
"""Largest distance between neighbouring points of a way."""

MARKER_HALF_M = 0.03
"""Half of the cube that stands for an object's root, so that one that nothing touches has a box too."""


class TaskWorkspace:
    """A task's workspace; see :class:`envs.randomization.channels.Workspace`.

    Args:
        task: The task, in its own scene.

    Attributes:
        robot: The robot that acts.
        support_z_m: Height of the table's top, or of the ground.

    Raises:
        ConfigError: Several robots act.
    """

    def __init__(self, task: Task) -> None:
        self._task, self.robot = task, task.only_robot("A channel that changes starts")
        table = task.scenario.table
        self.support_z_m = task.scenario.floor_z if table is None else table.pos[2]

    @cached_property
    def _contacts(self) -> ArmContacts:
        return ArmContacts(self._task.scenario, self.robot, gripper=True)

    def touches(self, state: State, qpos: np.ndarray) -> bool:
        """Whether the robot in the posture ``qpos`` (J,) touches itself, the table or an object."""
        return bool(self._contacts.count(state, 0, [qpos]))

    def hand(self, qpos: np.ndarray) -> np.ndarray:
        """Returns where the hand is in the posture ``qpos`` (J,), m, (3,)."""
        return self._hand(qpos)[0]

    def _hand(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        chain = _chain_of(self.robot)
        poses = chain(torch.as_tensor(qpos, dtype=torch.float64)[None, chain.columns])
        return poses.pos[0].numpy(), from_matrix(poses.rot[0].numpy())

    def way(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """Returns points of the hand on the expert's way from a start of one row, m, (P, 3)."""
        arm = state.robots[self.robot.name]
        pos, rot = self._hand(arm.joint_pos[0].numpy())
        one = State.unflatten(dict(state.flatten()))  # the caller's state stays as it is
        own = one.robots[self.robot.name]
        own.ee_pos, own.ee_rot = torch.from_numpy(pos)[None], torch.from_numpy(rot)[None]
        own.joint_target = arm.joint_pos[:, list(self.robot.driven)]
        corners = [pos, *(np.asarray(each.pos) for each in self._task.foreseen(one, rng))]
        points = [pos[None]]
        for start, end in pairwise(corners):
            count = max(1, int(np.ceil(np.linalg.norm(end - start) / STEP_M)))
            points.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
        return np.concatenate(points)

    def heights(self, state: State, points: np.ndarray) -> np.ndarray:
        """Returns how high what never moves is at points (K, 2), m, (K,); NaN where one cannot stand."""
        return self._contacts.heights(state, 0, points)

    def boxes(self, state: State) -> np.ndarray:
        """Returns least and largest corners of boxes round all geoms of the objects, m, (B, 2, 3)."""
        names = {item.name for item in self._task.scenario.objects}
        roots = [np.asarray(each.pos[0]) for name, each in state.objects.items() if name in names]
        marks = np.array(roots).reshape(-1, 1, 3) + MARKER_HALF_M * np.array([[[-1.0], [1.0]]])
        return np.concatenate([self._contacts.boxes(state, 0), marks])


@lru_cache(maxsize=16)
def _chain_of(robot: RobotCfg) -> KinematicChain:
    return KinematicChain(robot)
