"""Kinova Jaco's gripper of three fingers, the thumb opposite two, with the meshes of robosuite's wheel.

``jaco_three_finger.xml`` beside this file says where frames and shapes are from. A motor turns each finger at
its root. Its tip has none: a spring holds it straight against its stop, and it bends inwards where something
presses it. Ranges of 1.51 and 2 rad, gains, damping and the torque of 0.3 N·m are those of robosuite's file;
it is 4 N at a fingertip. The thumb holds against two fingers, so it is twice as strong. The screws of the
real fingers do not give way at all; dry friction of a sixth of the torque keeps a grip where it closed.

At 0.42 rad the thumb meets the fingers, and at 1.1 rad they are 87 mm apart. They spread to 116 mm, and their
tips rise on the way; that is left out, for what a task demands is a distance.
"""

from typing import Any

from envs.scenario import GripperCfg, JointCfg

_SHUT_RAD, _OPEN_RAD = 0.42, 1.1
_TORQUE_N_M, _FRICTION_N_M, _DAMPING = 0.3, 0.05, 0.15

_THUMB = 1.95
"""Twice as strong as a finger, less what its shorter lever gives."""

_NAMES = ("thumb", "index", "pinky")


def _root(name: str) -> JointCfg:
    strength = _THUMB if name == "thumb" else 1.0
    return JointCfg(
        name=f"gripper/joint_{name}",
        kp=20.0 * strength,
        kd=0.0,
        force_limit=_TORQUE_N_M * strength,
        range=(0.0, 1.51),
        default=_OPEN_RAD,
        damping=_DAMPING * strength,
        armature=0.001,
        frictionloss=_FRICTION_N_M * strength,
    )


_TIP: dict[str, Any] = {
    "kp": 0.0,
    "kd": 0.0,
    "force_limit": 0.0,
    "range": (0.0, 2.0),
    "default": 0.0,
    "damping": 0.1,
    "armature": 0.001,
    "driven": False,
}

JACO_THREE_FINGER = GripperCfg(
    mjcf="envs:robots/jaco_three_finger.xml",
    root="jaco_three_finger",
    ee_site="gripper/grip_site",
    joints=(
        *map(_root, _NAMES),
        *(JointCfg(name=f"gripper/joint_{name}_distal", **_TIP) for name in _NAMES),
    ),
    gripper_joints=tuple(f"gripper/joint_{name}" for name in _NAMES),
    range=((_SHUT_RAD, _OPEN_RAD),) * len(_NAMES),
    opening_m=0.087,
)
