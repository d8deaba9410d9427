"""LIBERO's 50 initial states of each task, as states of the scene."""

import numpy as np

from envs.core.errors import ConfigError
from envs.state import EntityState, State
from envs.tasks.libero.catalogue import Entry
from envs.tasks.libero.files import start_file
from envs.tasks.libero.scene import LiberoScene
from envs.tasks.libero_objects import read_init_states

ROBOT_JOINTS = 9
"""Seven of the arm, two of the fingers, of which the second is negative there."""


def fixed_starts(entry: Entry, scene: LiberoScene) -> State:
    """Returns the 50 states, (50 rows), as they are: objects hang over their places, some in the table.

    Raises:
        ConfigError: The file has rows of another width, or is damaged.
    """
    num_qpos = ROBOT_JOINTS + 7 * len(scene.problem.objects) + sum(_num_joints(scene))
    width = 1 + num_qpos + (num_qpos - len(scene.problem.objects))
    return states_of_rows(scene, read_init_states(start_file(entry), width))


def states_of_rows(scene: LiberoScene, rows: np.ndarray) -> State:
    """Returns states of robosuite's as states of the scene, objects where they are.

    Args:
        scene: The scene.
        rows: A row each: time, joints of the robot, poses of the objects and joints of the fixtures, each in
            the order of the task file, and velocities, which are not taken over.

    Raises:
        ConfigError: An orientation is none.
    """
    objects, fixtures, joints = list(scene.problem.objects), scene.fixtures, _num_joints(scene)
    count = len(rows)
    arm = rows[:, 1 : 1 + ROBOT_JOINTS] * np.array([1.0] * (ROBOT_JOINTS - 1) + [-1.0])
    poses = rows[:, 1 + ROBOT_JOINTS :][:, : 7 * len(objects)].reshape(count, len(objects), 7)
    rest = rows[:, 1 + ROBOT_JOINTS + 7 * len(objects) :]
    entities = {
        name: EntityState.at_rest(poses[:, index, :3], _unit(poses[:, index, 3:]))
        for index, name in enumerate(objects)
    }
    first = 0
    for name, size in zip(fixtures, joints, strict=True):
        item = scene.scenario.object(name)
        entities[name] = EntityState.at_rest(
            np.tile(item.pos, (count, 1)), np.array(item.rot), rest[:, first : first + size]
        )
        first += size
    for item in scene.scenario.objects:
        if item.name not in entities:
            entities[item.name] = EntityState.at_rest(np.tile(item.pos, (count, 1)), np.array(item.rot))
    robot = EntityState.at_rest(np.tile(scene.robot.pos, (count, 1)), np.array(scene.robot.rot), arm)
    return State(
        {scene.robot.name: robot}, {item.name: entities[item.name] for item in scene.scenario.objects}
    )


def _num_joints(scene: LiberoScene) -> list[int]:
    return [len(scene.parts[name].joints) for name in scene.fixtures]


def _unit(quats: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    if not (lengths > 0.5).all():
        raise ConfigError("An initial state of LIBERO has an orientation that is none.")
    return quats / lengths
