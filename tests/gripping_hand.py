"""A gripper on its arm in empty space, perhaps with a cube between its fingertips."""

import mujoco
import numpy as np

from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.scenario import GeomCfg, ObjectCfg, RobotCfg, ScenarioCfg
from envs.tasks.tabletop import CONTROL_20_HZ

_TIP_CONTYPE = 2
"""Of fingertips in the files of grippers that are ours."""


class GrippingHand:
    """A robot at rest without gravity.

    Args:
        robot: The robot.
        cube_m: Edge of a cube of 100 g between the fingertips; None is no cube.
    """

    def __init__(self, robot: RobotCfg, cube_m: float | None = None) -> None:
        cube = [] if cube_m is None else [_cube(cube_m)]
        scene = ScenarioCfg(
            robots=(robot,), objects=tuple(cube), table=None, room=None, physics=CONTROL_20_HZ
        )
        self.robot = robot
        self.model = build_model(scene)
        self.model.opt.gravity[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self.layout = layout_of(self.model, scene).robots[0]
        self.data.qpos[self.layout.qpos] = robot.default_qpos
        rest = np.array([joint.default for joint in robot.joints])
        self.data.ctrl[self.layout.ctrl] = rest[list(robot.driven)]
        mujoco.mj_forward(self.model, self.data)
        self.tips = np.flatnonzero(self.model.geom_contype == _TIP_CONTYPE).tolist()
        if cube:
            first = int(self.model.jnt_qposadr[self.model.body("cube").jntadr[0]])
            site, turn = self.data.site(self.layout.ee_site), np.empty(4)
            mujoco.mju_mat2Quat(turn, site.xmat)
            behind = 0.01 * site.xmat.reshape(3, 3)[:, 2]
            self.data.qpos[first : first + 7] = [*(site.xpos - behind), *turn]

    def move(self, seconds: float, targets: float | np.ndarray) -> None:
        """Steps with targets for the joints that open and close the gripper."""
        columns = [list(self.robot.driven).index(finger) for finger in self.robot.fingers]
        self.data.ctrl[np.array(self.layout.ctrl)[columns]] = targets
        mujoco.mj_step(self.model, self.data, round(seconds / self.model.opt.timestep))

    def close(self, seconds: float) -> None:
        """Steps with the targets of closed fingers."""
        self.move(seconds, self.robot.finger_positions(0.0))

    @property
    def gap_m(self) -> float:
        """Distance between the first fingertip and the nearest of the others."""
        mujoco.mj_kinematics(self.model, self.data)
        first, *others = self.tips
        return min(mujoco.mj_geomDistance(self.model, self.data, first, tip, 1.0, None) for tip in others)

    @property
    def joints(self) -> np.ndarray:
        """Positions of all joints."""
        return self.data.qpos[self.layout.qpos]

    @property
    def cube_in_hand(self) -> np.ndarray:
        """Position of the cube in the frame of the grip site, m, (3,)."""
        mujoco.mj_kinematics(self.model, self.data)
        site = self.data.site(self.layout.ee_site)
        return site.xmat.reshape(3, 3).T @ (self.data.body("cube").xpos - site.xpos)

    def presses(self) -> list[float]:
        """Returns the force by which each fingertip presses what it touches, N."""
        presses = []
        for tip in self.tips:
            force, total = np.zeros(6), 0.0
            for index, pair in enumerate(self.data.contact.geom):
                if tip in pair:
                    mujoco.mj_contactForce(self.model, self.data, index, force)
                    total += force[0]
            presses.append(total)
        return presses


def _cube(edge_m: float) -> ObjectCfg:
    return ObjectCfg(name="cube", geoms=(GeomCfg(shape="box", size=(edge_m / 2,) * 3, mass_kg=0.1),))
