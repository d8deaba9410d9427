"""Readings of joints: a robot's own units, converted at one place."""

import numpy as np
import pytest
import torch

from envs.controllers import HandDeltaController, JointPositionController
from envs.core.errors import ConfigError
from envs.joint_readings import joint_readings, target_readings
from envs.robots.franka import FRANKA
from envs.robots.so101 import SO101
from envs.scenario import ReadingCfg
from envs.state import EntityState, State

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def test_positions_of_a_robot_without_units_pass_untouched():
    readings = joint_readings(FRANKA)
    values, tensor = np.ones((2, 9), np.float32), torch.ones((2, 9), dtype=torch.float32)
    assert readings.read(values) is values and readings.positions(values) is values
    assert readings.read(tensor) is tensor and readings.positions(tensor) is tensor
    assert readings.names == FRANKA.joint_names
    low, high = readings.limits([joint.range for joint in FRANKA.joints])
    assert tuple(zip(low, high, strict=True)) == tuple(joint.range for joint in FRANKA.joints)


def test_so101_is_read_in_degrees_and_percent():
    readings = joint_readings(SO101)
    closed = [np.pi / 2, -np.pi / 4, 0.0, 0.1, -1.0, np.radians(-10.0)]
    opened = [0.0] * 5 + [np.radians(100.0)]
    read = readings.read(np.array([closed, opened]))
    assert np.allclose(read[0], [90.0, -45.0, 0.0, np.degrees(0.1), np.degrees(-1.0), 0.0])
    assert np.allclose(read[1], [0.0] * 5 + [100.0])
    assert readings.names == tuple(f"{name}.pos" for name in NAMES)


def test_readings_and_positions_are_inverse():
    readings = target_readings(SO101)
    positions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 6))
    assert np.allclose(readings.positions(readings.read(positions)), positions, atol=1e-12)


def test_a_reading_is_the_same_from_single_and_double_precision():
    """States of a simulator in single precision are recorded in double precision."""
    single = torch.rand((100, 6), generator=torch.Generator().manual_seed(0))
    readings = joint_readings(SO101)
    live, recorded = readings.read(single), readings.read(single.to(torch.float64))
    assert torch.equal(live, recorded)
    assert np.array_equal(live.numpy(), readings.read(single.numpy()))


def test_limits_keep_their_order_where_a_scale_is_negative():
    from dataclasses import replace

    flipped = replace(SO101.joints[0], reading=ReadingCfg(name="turned", scale=-2.0, zero=1.0))
    robot = replace(SO101, joints=(flipped, *SO101.joints[1:]))
    low, high = joint_readings(robot).limits([joint.range for joint in robot.joints])
    assert (low[0], high[0]) == pytest.approx((-2.0 * (np.radians(110) - 1), 2.0 * (np.radians(110) + 1)))


def test_a_reading_without_a_scale_is_refused():
    with pytest.raises(ConfigError, match=r"'gripper\.pos' has a scale of 0"):
        ReadingCfg(name="gripper.pos", scale=0.0)


class Recorder:
    """Stands for a simulator: keeps the targets that a controller sets."""

    def set_joint_targets(self, targets, env_ids=None):
        self.targets = targets["so101"]


def test_actions_in_degrees_become_targets_in_radians():
    controller, simulator = JointPositionController(SO101), Recorder()
    controller.apply(simulator, np.array([[90.0, 0.0, 0.0, 0.0, 0.0, 100.0]], np.float32))
    assert np.allclose(simulator.targets, [[np.pi / 2, 0, 0, 0, 0, np.radians(100.0)]])
    assert controller.names == tuple(f"{name}.pos" for name in NAMES)
    assert np.allclose(
        controller.low, [-110, -100, np.degrees(-1.69), -95, np.degrees(-2.74385), 0], atol=1e-4
    )
    assert np.allclose(controller.high, [110, 100, np.degrees(1.69), 95, np.degrees(2.84121), 100], atol=1e-4)


def test_held_actions_and_those_of_the_hand_are_in_the_tasks_units():
    qpos = torch.tensor([[0.1, -0.4, 0.46, 1.5, 0.05, 0.3]], dtype=torch.float64)
    arm = EntityState.at_rest(np.zeros(3), np.array([[1.0, 0, 0, 0]]), qpos.numpy())
    arm.joint_target = qpos
    state = State({"so101": arm}, {})
    held = JointPositionController(SO101).hold(state)
    assert np.allclose(held[0, :5], np.degrees(qpos[0, :5].numpy()))
    still = HandDeltaController(SO101.with_home(tuple(qpos[0].tolist())))
    actions = still.as_task_actions(state, still.hold(state))
    assert np.allclose(actions, held, atol=0.3), "a hand that stays keeps its joints, in degrees and percent"
