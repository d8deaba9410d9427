"""Unitree H1 with two Shadow hands, HumanoidBench's ``h1hand``: 69 joints, 61 actuators.

HumanoidBench (Sferrazza et al., RSS 2024, arXiv:2403.10506, MIT) is the source of every number:
``robots/h1hand_pos.xml`` and the file that it includes for each hand, ``shadow_hand_menagerie``, which is
MuJoCo Menagerie's Shadow Hand E3M5 (Apache-2.0) without its forearm. The files are not in this package:
``roboverse assets get humanoid_bench`` downloads them. Body, damping, armature and dry friction are those of
the file.

Joints have the order of the published ``qpos``. One actuator bends the last two joints of a finger, over a
tendon as long as the sum of both. Actuators, and so actions, have the order of their joints; the published
one has the body's first and the thumb's before the fingers'.
"""

import dataclasses
from pathlib import Path
from typing import NamedTuple

from envs.robots.h1 import SERVOS, STAND_HEIGHT_M
from envs.scenario import JointCfg, RobotCfg

_FILE = "robots/h1hand_pos.xml"


class _Servo(NamedTuple):
    """A position actuator of a hand, which has no damping gain.

    Attributes:
        name: Joint, without the prefix of its side.
        kp: Gain, N·m/rad.
        force: Largest force, N·m.
        range: Range of the joint, rad.
        bends: The joint after it that the same actuator bends, or none.
    """

    name: str
    kp: float
    force: float
    range: tuple[float, float]
    bends: str = ""


_KNUCKLE, _PROXIMAL, _BENT = (-0.349066, 0.349066), (-0.261799, 1.5708), (0.0, 1.5708)
_TENDON_RANGE = (0.0, 3.1415)


def _finger(name: str) -> tuple[_Servo, ...]:
    return (
        _Servo(f"{name}J4", 1.0, 1.0, _KNUCKLE),
        _Servo(f"{name}J3", 1.0, 1.0, _PROXIMAL),
        _Servo(f"{name}J2", 0.5, 1.0, _BENT, bends=f"{name}J1"),
    )


_HAND = (
    _Servo("WRJ2", 10.0, 10.0, (-0.523599, 0.174533)),
    _Servo("WRJ1", 8.0, 5.0, (-0.698132, 0.488692)),
    *_finger("FF"),
    *_finger("MF"),
    *_finger("RF"),
    _Servo("LFJ5", 1.0, 1.0, (0.0, 0.785398)),
    *_finger("LF"),
    _Servo("THJ5", 0.4, 3.0, (-1.0472, 1.0472)),
    _Servo("THJ4", 1.0, 2.0, (0.0, 1.22173)),
    _Servo("THJ3", 0.5, 1.0, (-0.20944, 0.20944)),
    _Servo("THJ2", 1.5, 1.0, (-0.698132, 0.698132)),
    _Servo("THJ1", 1.0, 1.0, (-0.261799, 1.5708)),
)
"""Actuators of a hand: the classes ``left_hand`` and ``right_hand`` of the file, which are alike."""


def _of_hand(side: str) -> tuple[JointCfg, ...]:
    joints = []
    for servo in _HAND:
        gains = {"kp": servo.kp, "kd": 0.0, "force_limit": servo.force}
        shape = {"range": servo.range, "default": 0.0}
        name = f"{side}_{servo.name}"
        if not servo.bends:
            joints.append(JointCfg(name=name, **gains, **shape))
            continue
        other = f"{side}_{servo.bends}"
        joints.append(
            JointCfg(name=name, **gains, **shape, pulls=((other, 1.0),), target_range=_TENDON_RANGE)
        )
        joints.append(JointCfg(name=other, kp=0.0, kd=0.0, force_limit=0.0, **shape, driven=False))
    return tuple(joints)


def _of_body(first: int, last: int) -> tuple[JointCfg, ...]:
    return tuple(
        JointCfg(name=name, kp=kp, kd=kd, force_limit=force, range=limits, default=rest)
        for name, kp, kd, force, limits, rest in SERVOS[first:last]
    )


def _arm(side: str, first: int) -> tuple[JointCfg, ...]:
    """Returns an arm of four joints, the one between elbow and hand, and the hand."""
    turn = JointCfg(
        name=f"{side}_wrist_yaw", kp=100.0, kd=2.0, force_limit=18.0, range=(-0.15, 1.57), default=0.0
    )
    return (*_of_body(first, first + 4), turn, *_of_hand(f"{side[0]}h"))


H1_HAND = RobotCfg(
    name="h1_hand",
    mjcf=f"assets.humanoid_bench:humanoid_bench/assets/{_FILE}",
    root="pelvis",
    joints=(*_of_body(0, 11), *_arm("left", 11), *_arm("right", 15)),
    ee_site="head",
    pos=(0.0, 0.0, STAND_HEIGHT_M),
    fixed_base=False,
    gravity_compensated=False,
)


def h1_hand_of(folder: str) -> RobotCfg:
    """Returns the robot of a folder of HumanoidBench's assets; an empty name is :data:`H1_HAND`."""
    return dataclasses.replace(H1_HAND, mjcf=str(Path(folder) / _FILE)) if folder else H1_HAND
