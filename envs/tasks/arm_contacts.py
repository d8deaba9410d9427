"""How often an arm would touch what it must not: itself, the table, and objects where they start.

The gripper may touch: that is what it is for.
"""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from envs.mjcf.layout import EntityLayout, layout_of
from envs.mjcf.model import build_models
from envs.scenario import RobotCfg, ScenarioCfg
from envs.state import EntityState, State

TOUCHING_M = -0.002
"""Distance of two shapes below which they touch: collision shapes of neighbours overlap a little."""

RAY_FROM_M = 3.0
"""Height from which heights are looked for: above everything on a table."""

_DOWN = np.array([0.0, 0.0, -1.0])


class ArmContacts:
    """Counts contacts of an arm in a scene, and finds what else is there.

    Args:
        scenario: The scene.
        robot: The robot in place of its own.
        gripper: Whether contacts of the gripper count too.
    """

    def __init__(self, scenario: ScenarioCfg, robot: RobotCfg, *, gripper: bool = False) -> None:
        unfeeling = tuple(replace(item, feels=()) for item in scenario.objects)  # of the robot that is gone
        scene = replace(scenario, robots=(robot,), objects=unfeeling, cameras=())
        _, self._model = build_models(scene, prune=True)
        self._data = mujoco.MjData(self._model)
        self._layout = layout_of(self._model, scene)
        names = [self._model.body(index).name for index in range(self._model.nbody)]
        prefix = f"{robot.name}/"
        self._is_arm = np.array(
            [
                name.startswith(prefix) and (gripper or not name.startswith(f"{prefix}gripper/"))
                for name in names
            ]
        )
        self._is_robot = np.array([name.startswith(prefix) for name in names])
        objects = {item.name for item in scene.objects}
        of_object = np.array([name.partition("/")[0] in objects for name in names])
        self._object_geoms = np.flatnonzero(of_object[self._model.geom_bodyid])

    def count(self, start: State, row: int, postures: Sequence[np.ndarray]) -> int:
        """Returns in how many postures the arm touches something.

        Args:
            start: A start of the task; its objects stay where they are.
            row: Which of its rows.
            postures: Positions of all joints of the robot, (J,) each.
        """
        self._place(start, row)
        (robot,) = self._layout.robots
        touching = 0
        for qpos in postures:
            self._data.qpos[robot.qpos] = qpos
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            touching += self._touches()
        return touching

    def boxes(self, start: State, row: int) -> np.ndarray:
        """Returns boxes along the world's axes round what collides of the objects at a start, m.

        Args:
            start: As in :meth:`count`.
            row: Which of its rows.

        Returns:
            Least and largest corners, (B, 2, 3).
        """
        self._place(start, row)
        mujoco.mj_kinematics(self._model, self._data)
        geoms, model = self._object_geoms, self._model
        turns = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        middle = self._data.geom_xpos[geoms] + np.einsum("bij,bj->bi", turns, model.geom_aabb[geoms, :3])
        half = np.einsum("bij,bj->bi", np.abs(turns), model.geom_aabb[geoms, 3:])
        return np.stack([middle - half, middle + half], axis=1)

    def heights(self, start: State, row: int, points: np.ndarray) -> np.ndarray:
        """Returns how high what never moves is at points of a start, m: tables, desks, the ground.

        Args:
            start: As in :meth:`count`.
            row: Which of its rows.
            points: x and y, m, (K, 2).

        Returns:
            Heights, (K,); NaN where the robot or something that moves is above, or nothing is below.
        """
        self._place(start, row)
        mujoco.mj_kinematics(self._model, self._data)
        heights, geom = np.full(len(points), np.nan), np.array([-1], np.int32)
        for index, (x, y) in enumerate(points):
            above = np.array([x, y, RAY_FROM_M])
            distance = mujoco.mj_ray(self._model, self._data, above, _DOWN, None, 1, -1, geom)
            body = self._model.geom_bodyid[geom[0]]
            rests = self._model.body_dofnum[self._model.body_weldid[body]] == 0
            if distance >= 0 and rests and not self._is_robot[body]:
                heights[index] = RAY_FROM_M - distance
        return heights

    def _touches(self) -> bool:
        contact = self._data.contact
        if not len(contact.dist):
            return False
        one, other = self._model.geom_bodyid[contact.geom].T
        arm = self._is_arm[one] | self._is_arm[other]
        base = self._model.body_weldid == 0  # what is bolted down may stand on its pedestal
        moving = ~(base[one] & base[other])
        return bool((arm & moving & (contact.dist < TOUCHING_M)).any())

    def _place(self, start: State, row: int) -> None:
        mujoco.mj_resetData(self._model, self._data)
        for layout in self._layout.objects:
            if layout.name in start.objects:
                self._write(layout, start.objects[layout.name], row)

    def _write(self, layout: EntityLayout, entity: EntityState, row: int) -> None:
        pos, rot = np.asarray(entity.pos[row]), np.asarray(entity.rot[row])
        if layout.root == "free":
            self._data.qpos[layout.root_qpos : layout.root_qpos + 7] = np.concatenate([pos, rot])
        elif layout.root == "mocap":
            self._data.mocap_pos[layout.mocap], self._data.mocap_quat[layout.mocap] = pos, rot
        if len(layout.qpos):
            self._data.qpos[layout.qpos] = np.asarray(entity.joint_pos[row])
