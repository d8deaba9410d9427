"""Markers of a recording, which hold what happened before each moment; files record each moment alone."""

from dataclasses import replace

import torch

from envs.kinematics.forward import KinematicChain
from envs.rotations import from_matrix
from envs.state import State
from envs.tasks.base import Task
from roboverse_learn.data.importers.demonstration import tensor


def remember(task: Task, states: State) -> None:
    """Sets the markers of recorded states (R rows), in place, as an episode through these states would.

    Args:
        task: A task; most have no memory, and their states stay as they are.
        states: The moments in order, with every marker as it was at first.
    """
    if type(task).memory is Task.memory:
        return
    robots = dict(states.robots)
    for robot in task.robots:
        chain, entity = KinematicChain(robot), states.robots[robot.name]
        hands = chain(entity.joint_pos[:, chain.columns].to(torch.float64))
        robots[robot.name] = replace(entity, ee_pos=hands.pos, ee_rot=tensor(from_matrix(hands.rot.numpy())))
    seen = State(robots, states.objects)
    for row in range(1, states.num_envs):  # no step led to the first state
        for name, (pos, rot) in task.memory(seen.select([row])).items():
            marker = states.objects[name]
            marker.pos[row:], marker.rot[row:] = torch.as_tensor(pos), torch.as_tensor(rot)
