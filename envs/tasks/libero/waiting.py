"""Where the arm is when an evaluation of LIBERO begins: after the steps that it waits for objects to fall.

LIBERO and LeRobot set one of the 50 states and then take some steps with an action of zeros. Objects are
seated here, but the arm moves in these steps, too, since robosuite's controller does not know that the state
was set: its goal of the first step is the place of the hand at rest, and that of all steps has the hand's
orientation at rest.
"""

import numpy as np
import torch
from torch import Tensor

from envs.operational_space import DELTA_M, OperationalSpaceController
from envs.scenario import RobotCfg, ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks.libero.native import AIR
from envs.tasks.tabletop import CONTROL_20_HZ, ee_pos

WAITED_STEPS = 10
"""``num_steps_wait`` of LeRobot's environment."""

_OPEN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)


def joints_after_waiting(robot: RobotCfg, joint_pos: Tensor) -> Tensor:
    """Returns the positions (n, J) of all joints after the steps of waiting, in which the hand opens.

    Args:
        robot: A robot for :class:`~envs.operational_space.OperationalSpaceController`, at rest at home.
        joint_pos: Its joints in the states that were set, (n, J), rad and m.
    """
    count = len(joint_pos)
    scenario = ScenarioCfg(
        robots=(robot,), table=None, room=None, physics=CONTROL_20_HZ, simulators={"mujoco": AIR}
    )
    controller, actions = OperationalSpaceController(robot), np.tile(_OPEN, (count, 1))
    with MujocoHandler(scenario, count, num_threads=1) as handler:
        handler.launch()
        rest = _set_joints(handler, robot, torch.tensor([robot.default_qpos] * count).to(joint_pos))
        controller.apply(handler, actions)  # sets the goal's orientation
        start = _set_joints(handler, robot, joint_pos)
        first = actions.copy()
        first[:, :3] = (rest - start) / DELTA_M
        for step in range(WAITED_STEPS):
            controller.advance(handler, actions if step else first, scenario.physics.decimation)
        return handler.get_states().robots[robot.name].joint_pos.clone()


def _set_joints(handler: MujocoHandler, robot: RobotCfg, joint_pos: Tensor) -> np.ndarray:
    """Puts all arms into postures at rest; returns where their hands are, m, (n, 3)."""
    state = handler.get_states()
    entity = state.robots[robot.name]
    entity.joint_pos, entity.joint_vel, entity.joint_target = joint_pos, torch.zeros_like(joint_pos), None
    handler.set_states(state)
    return ee_pos(handler.get_states().robots[robot.name]).numpy()
