"""SO-101, the follower arm of LeRobot: five joints and a gripper, as data: ``so101.xml`` beside this file.

- Frames, masses, inertias and ranges: the maker's model with the calibration in which zero is the middle of
  a joint's range (``TheRobotStudio/SO-ARM100``, ``Simulation/SO101/so101_new_calib.xml``, Apache-2.0).
  Shapes are primitives of this project.
- Servos, Feetech STS3215 with 12 V: position gain 998 N·m/rad, 2.94 N·m, a damping of 0.6 N·m·s/rad, a dry
  friction of 0.052 N·m and a rotor inertia of 0.028 kg·m², all of the same file. Its velocity gain leaves
  joints underdamped, and this project takes critical damping of the rotor, ``2 √(kp · armature)`` = 10.6.
- Gravity bends a joint of that gain by at most 1 mrad, a step of the servo's encoder (0.088°), so it is left
  out, as in the other arms.
- Readings are LeRobot's (``robots/so_follower``, ``use_degrees=True``): degrees about the middle of the
  range, and the gripper from 0, closed, to 100, all open.
"""

from math import degrees, radians

from envs.scenario import JointCfg, ReadingCfg, RobotCfg

_JAW = (radians(-10.0), radians(100.0))

_GRIP_N_M = 0.25 * 2.94
"""Torque of a gripper that holds something: LeRobot sets its ``Overload_Torque`` to 25 %."""

_ARM = (
    # name, range, rest
    ("shoulder_pan", (radians(-110.0), radians(110.0)), 0.0),
    ("shoulder_lift", (radians(-100.0), radians(100.0)), 0.0),
    ("elbow_flex", (-1.69, 1.69), 0.0),
    ("wrist_flex", (radians(-95.0), radians(95.0)), 0.0),
    ("wrist_roll", (-2.74385, 2.84121), 0.0),
)

_OPEN_RAD = 0.6
"""Jaw at which the fingers are :data:`_OPENING_M` apart: wide enough for what it lifts, and nearly linear."""

_OPENING_M = 0.0538
"""Distance of the fingers at the grip site at that opening, by the shapes of ``so101.xml``."""


def _servo(
    name: str,
    limits: tuple[float, float],
    rest: float,
    scale: float,
    zero: float = 0.0,
    force_limit: float = 2.94,
) -> JointCfg:
    """Returns a joint of an STS3215, which LeRobot reads as ``scale * (position - zero)``."""
    return JointCfg(
        name=name,
        kp=998.22,
        kd=10.6,
        force_limit=force_limit,
        range=limits,
        default=rest,
        damping=0.6,
        armature=0.028,
        frictionloss=0.052,
        reading=ReadingCfg(name=f"{name}.pos", scale=scale, zero=zero),
    )


SO101 = RobotCfg(
    name="so101",
    mjcf="envs:robots/so101.xml",
    root="base",
    joints=(
        *(_servo(name, limits, rest, degrees(1.0)) for name, limits, rest in _ARM),
        _servo("gripper", _JAW, _OPEN_RAD, 100.0 / (_JAW[1] - _JAW[0]), _JAW[0], force_limit=_GRIP_N_M),
    ),
    ee_site="grip_site",
    gripper_joints=("gripper",),
    gripper_range=((_JAW[0], _OPEN_RAD),),
    gripper_opening_m=_OPENING_M,
    camera_mount="gripper",
    lerobot_type="so101_follower",
)
