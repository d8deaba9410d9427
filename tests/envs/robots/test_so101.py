"""The SO-101: what its file promises to a policy of the real arm."""

import mujoco
import numpy as np
import pytest
import torch

from envs.joint_readings import joint_readings
from envs.kinematics.forward import KinematicChain
from envs.mjcf.robots import robot_spec
from envs.robots.so101 import SO101
from envs.tasks.so101.scene import REST_RAD, SITE_TO_FINGER_M
from tests.envs.robots.fake_so101_bus import RANGES, follower, radians_of

STRAIGHT_M = 0.3833
"""Reach along x of the arm at zero, from base to grip site: the sum of the maker's frames."""


def posed(qpos):
    model = robot_spec(SO101).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return model, data


def fingers(model):
    """Returns the geoms of the two fingers, the fixed one first: those that turn a thing that they hold."""
    return [geom for geom in range(model.ngeom) if model.geom_priority[geom] == 1]


def test_its_joints_are_lerobots_motors_in_their_order_and_units(monkeypatch, tmp_path):
    robot = follower(monkeypatch, tmp_path)
    assert SO101.reading_names == tuple(robot.action_features)
    assert SO101.lerobot_type == "so101_follower"
    robot.connect()
    robot.bus.ticks |= {"shoulder_pan": 2048 + 300, "wrist_flex": 2048 - 500, "gripper": RANGES["gripper"][0]}
    seen = robot.get_observation()
    qpos = [radians_of(name, tick) for name, tick in list(robot.bus.ticks.items())[:5]]
    ours = joint_readings(SO101).read(np.array([*qpos, SO101.joints[5].range[0]]))
    assert list(seen.values()) == pytest.approx(ours.tolist(), abs=1e-6)


def test_an_action_of_the_twin_is_what_the_real_motors_get(monkeypatch, tmp_path):
    robot = follower(monkeypatch, tmp_path)
    robot.connect()
    qpos = np.array([0.3, -0.5, 0.4, 1.2, -1.0, 0.6])
    action = dict(zip(SO101.reading_names, joint_readings(SO101).read(qpos).tolist(), strict=True))
    robot.send_action(action)
    tick = 2 * np.pi / 4095
    for name, angle in zip(RANGES, qpos[:5], strict=False):
        assert radians_of(name, robot.bus.ticks[name]) == pytest.approx(angle, abs=tick)
    low, high = RANGES["gripper"]
    jaw_low, jaw_high = SO101.joints[5].range
    share = (robot.bus.ticks["gripper"] - low) / (high - low)
    assert share == pytest.approx((0.6 - jaw_low) / (jaw_high - jaw_low), abs=1e-3)


def test_lerobots_limit_of_a_step_is_in_the_same_units(monkeypatch, tmp_path):
    robot = follower(monkeypatch, tmp_path, max_relative_target=5.0)
    robot.connect()
    action = dict.fromkeys(SO101.reading_names, 0.0) | {"shoulder_pan.pos": 40.0}
    sent = robot.send_action(action)
    assert sent["shoulder_pan.pos"] == pytest.approx(5.0, abs=0.1)


def test_all_joints_at_zero_stretch_the_arm_ahead():
    _, data = posed(np.zeros(6))
    site = data.site("so101/grip_site")
    assert site.xpos == pytest.approx([STRAIGHT_M, 0.0, 0.24], abs=2e-3)
    assert site.xmat.reshape(3, 3)[:, 2] == pytest.approx([1.0, 0.0, 0.0], abs=0.01), "fingers point ahead"


def test_positive_angles_turn_as_the_maker_says():
    """Pan to the right seen from above, lift and elbow and wrist down, as in the calibrated model."""
    _, zero = posed(np.zeros(6))
    start = zero.site("so101/grip_site").xpos.copy()

    def moved(joint):
        qpos = np.zeros(6)
        qpos[joint] = 0.3
        return posed(qpos)[1].site("so101/grip_site").xpos - start

    assert moved(0)[1] < -0.05
    assert all(moved(joint)[2] < -0.01 for joint in (1, 2, 3))
    assert np.abs(moved(4)).max() < 5e-3


def test_the_hand_points_straight_down_at_rest():
    chain = KinematicChain(SO101)
    pose = chain(torch.tensor([REST_RAD], dtype=torch.float64)[:, chain.columns])
    assert pose.pos[0].numpy() == pytest.approx([0.19, 0.0, 0.08], abs=1e-4)
    assert pose.rot[0].numpy() == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-4)


@pytest.mark.parametrize("width_m", [0.0, 0.012, 0.03])
def test_the_gripper_opens_by_the_commanded_width(width_m):
    jaw = float(SO101.finger_positions(width_m / 2)[0])
    model, data = posed([*np.zeros(5), jaw])
    fixed, moving = fingers(model)
    rot, at = data.site("so101/grip_site").xmat.reshape(3, 3), data.site("so101/grip_site").xpos
    face = data.geom_xpos[moving] - model.geom_size[moving][0] * data.geom_xmat[moving].reshape(3, 3)[:, 0]
    normal = rot.T @ data.geom_xmat[moving].reshape(3, 3)[:, 0]
    local = rot.T @ (face - at)
    along = local[0] + local[2] * normal[2] / normal[0]  # where the jaw's face crosses the site's x axis
    assert along + SITE_TO_FINGER_M == pytest.approx(width_m, abs=3e-3)
    own = rot.T @ (data.geom_xpos[fixed] - at)
    assert own[0] + model.geom_size[fixed][0] == pytest.approx(-SITE_TO_FINGER_M, abs=2e-4)


def test_nothing_touches_in_the_postures_of_its_tasks():
    for qpos in (np.zeros(6), REST_RAD):
        _, data = posed(qpos)
        assert not data.ncon
