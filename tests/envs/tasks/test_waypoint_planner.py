"""Plans for a robot with a passive joint: targets of its driven joints alone."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.controllers import JointPositionController
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.scenario import ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks.waypoint_planner import WaypointPlanner

*ARM, LEFT, RIGHT = FRANKA.joints
ROBOT = dataclasses.replace(
    FRANKA,
    joints=(LEFT, *ARM[:1], dataclasses.replace(RIGHT, driven=False), *ARM[1:]),
    gripper_joints=(LEFT.name,),
)


def way(state, _):
    return [
        Waypoint(
            pos=state.robots["franka"].ee_pos[0].numpy() - [0, 0, 0.05], yaw=0.0, gripper=0.04, duration_s=0.5
        )
    ]


@pytest.mark.slow
def test_a_robot_with_a_passive_joint_follows_a_plan_of_its_driven_joints():
    scenario = ScenarioCfg(robots=(ROBOT,))
    controller, planner = JointPositionController(ROBOT), WaypointPlanner(scenario, way)
    assert controller.names == (LEFT.name, *(joint.name for joint in ARM))
    with MujocoHandler(scenario, 2, num_threads=1) as handler:
        handler.launch()
        state, rng = handler.get_states(), np.random.default_rng(0)
        assert controller.hold(state).shape == (2, 8)
        plan = planner.plan(state.select([0]), rng)
        assert plan.shape == (10, 8) and plan.dtype == np.float32
        for batched in planner.plan_batch(state, [rng, rng]):
            np.testing.assert_allclose(batched, plan, atol=1e-3)
        start = state.robots["franka"].ee_pos
        for targets in plan:
            controller.advance(handler, torch.from_numpy(targets).repeat(2, 1), scenario.physics.decimation)
        moved = handler.get_states().robots["franka"].ee_pos - start
        np.testing.assert_allclose(moved, [[0.0, 0.0, -0.05]] * 2, atol=0.01)
