"""Inverse kinematics of one path or of many is mink's, bit by bit."""

import mink
import numpy as np
import pytest

from envs.kinematics.batched_inverse import DAMPING, ITERATIONS_PER_STEP, ORIENTATION_COST, POSTURE_COST
from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint, interpolate
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.robots import ROBOTS
from envs.rotations import conjugate, from_euler, multiply, to_euler
from envs.scenario import ScenarioCfg

HZ = 20.0


class ByMink:
    """One path after another by ``mink.solve_ik``."""

    def __init__(self, robot):
        scenario = ScenarioCfg(robots=(robot,), table=None, room=None)
        self.robot, self.model = robot, build_model(scenario)
        self.columns = layout_of(self.model, scenario).robots[0].qpos
        self.site = f"{robot.name}/{robot.ee_site}"
        self.configuration = mink.Configuration(self.model)
        self.frame = mink.FrameTask(
            self.site, "site", position_cost=1.0, orientation_cost=ORIENTATION_COST, lm_damping=DAMPING
        )
        self.posture = mink.PostureTask(self.model, cost=POSTURE_COST)

    def pose(self, qpos):
        full = np.zeros(self.model.nq)
        full[self.columns] = qpos
        self.configuration.update(full)
        site = self.configuration.data.site(self.site)
        return site.xpos.copy(), mink.SO3.from_matrix(site.xmat.reshape(3, 3)).wxyz

    def targets(self, qpos, way):
        _, down = self.pose(self.robot.default_qpos)
        self.posture.set_target_from_configuration(self.configuration)
        pos, rot = self.pose(qpos)
        yaw, pitch, roll = to_euler(multiply(rot, conjugate(down)))
        first = Waypoint(pos=pos, yaw=yaw, pitch=pitch, roll=roll, gripper=0.0, duration_s=0.0)
        path = interpolate(first, way, HZ)
        found = []
        for place, turn in zip(path.pos, path.turn, strict=True):
            goal = mink.SO3(multiply(from_euler(turn), down))
            self.frame.set_target(mink.SE3.from_rotation_and_translation(goal, place))
            for _ in range(ITERATIONS_PER_STEP):
                velocity = mink.solve_ik(
                    *(self.configuration, [self.frame, self.posture], 1.0 / HZ, "daqp"), damping=DAMPING
                )
                self.configuration.integrate_inplace(velocity, 1.0 / HZ)
            found.append(self.configuration.q[self.columns])
        found = np.array(found)
        found[:, self.robot.fingers] = self.robot.finger_positions(path.gripper)
        return found


def ways(reference, starts, reach_m, far_rad):
    """Ways of other lengths; the last turns the hand farther than a wrist can."""
    rng, out = np.random.default_rng(1), []
    for row, start in enumerate(starts):
        pos, _ = reference.pose(start)
        goal, yaw = pos + rng.uniform(-reach_m, reach_m, 3), far_rad if row + 1 == len(starts) else 0.3 * row
        first = Waypoint(pos=goal, yaw=yaw, gripper=0.02, duration_s=0.4 + 0.1 * (row % 3))
        out.append([first, Waypoint(pos=pos, yaw=yaw, gripper=0.0, duration_s=0.5, hold_s=0.1)])
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reach_m", "far_rad"), [("franka", 0.3, 4.0), ("so101", 0.1, 4.0), ("ur5e_2f85", 0.2, 8.0)]
)
def test_targets_are_minks_bit_by_bit_for_any_number_of_paths(name, reach_m, far_rad):
    robot = ROBOTS.get(name)
    reference, follower = ByMink(robot), PathFollower(robot, HZ)
    noise = np.random.default_rng(0).normal(0.0, 0.03, (5, len(robot.joints)))
    starts = np.array(robot.default_qpos) + noise
    given = ways(reference, starts, reach_m, far_rad)
    expected = [reference.targets(start, way) for start, way in zip(starts, given, strict=True)]
    low, high = np.array([joint.range for joint in robot.joints]).T
    arm = list(robot.arm)
    nearest = np.minimum(high - expected[-1], expected[-1] - low)[:, arm].min()
    assert nearest < 0.01, "some joint is held by its limit"
    assert len({len(targets) for targets in expected}) > 1
    for found in (
        follower.targets_of_all(starts, given),
        follower.targets_of_all(starts[::-1], given[::-1])[::-1],
        [follower.joint_targets(start, way) for start, way in zip(starts, given, strict=True)],
    ):
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)
