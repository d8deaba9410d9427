"""LeRobot's driver of an SO-101 on motors that are a dictionary of ticks, for a machine without an arm.

Names, order, units and limits are LeRobot's own code; serial communication alone is replaced.
"""

from contextlib import contextmanager

import numpy as np
from lerobot.motors import MotorCalibration
from lerobot.motors.feetech import FeetechMotorsBus
from lerobot.motors.motors_bus import MotorsBusBase
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig, so_follower

TICKS = 4096
"""Encoder ticks of a turn of an STS3215."""

RANGES = {
    # least and largest tick of each motor, of a calibration whose middle is a tick of 2048
    "shoulder_pan": (2048 - 1251, 2048 + 1251),
    "shoulder_lift": (2048 - 1137, 2048 + 1137),
    "elbow_flex": (2048 - 1101, 2048 + 1101),
    "wrist_flex": (2048 - 1080, 2048 + 1080),
    "wrist_roll": (0, 4095),
    "gripper": (2048 - 114, 2048 + 1138),
}


class FakeBus(FeetechMotorsBus):
    """Motors that reach their target positions at once.

    Attributes:
        ticks: Where each motor is.
        sent: Ticks of every command, in order.
    """

    def __init__(self, port, motors, calibration=None):
        MotorsBusBase.__init__(self, port, motors, calibration)
        self._id_to_model_dict = {motor.id: motor.model for motor in motors.values()}
        self._id_to_name_dict = {motor.id: name for name, motor in motors.items()}
        self.calibration = {
            name: MotorCalibration(motor.id, 0, 0, *RANGES[name]) for name, motor in motors.items()
        }
        self.ticks = {name: 2048 for name in motors}
        self.sent, self._open = [], False

    @property
    def is_connected(self):
        return self._open

    @property
    def is_calibrated(self):
        return True

    def connect(self, handshake=True):
        self._open = True

    def disconnect(self, disable_torque=True):
        self._open = False

    def configure_motors(self, *_, **__):
        pass

    def write(self, *_, **__):
        pass

    @contextmanager
    def torque_disabled(self, *_):
        yield

    def sync_read(self, data_name, motors=None, *, normalize=True, num_retry=0):
        assert data_name == "Present_Position"
        by_id = self._normalize({self.motors[name].id: tick for name, tick in self.ticks.items()})
        return {name: by_id[motor.id] for name, motor in self.motors.items()}

    def sync_write(self, data_name, values, *, normalize=True, num_retry=0):
        assert data_name == "Goal_Position"
        by_id = self._unnormalize({self.motors[name].id: value for name, value in values.items()})
        self.ticks |= {name: by_id[self.motors[name].id] for name in values}
        self.sent.append(dict(self.ticks))


def follower(monkeypatch, folder, **options):
    """Returns LeRobot's SO-101 on fake motors, not yet connected."""
    monkeypatch.setattr(so_follower, "FeetechMotorsBus", FakeBus)
    return SO101Follower(SO101FollowerConfig(port="/dev/none", calibration_dir=folder, id="fake", **options))


def radians_of(name, tick):
    """Returns the angle of a motor about the middle of its range, rad."""
    return (tick - sum(RANGES[name]) / 2) * 2 * np.pi / (TICKS - 1)
