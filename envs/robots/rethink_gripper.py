"""Rethink's electric parallel gripper, with the meshes of robosuite's wheel.

``rethink_gripper.xml`` beside this file says where frames and shapes are from. Strokes and the force of 20 N
on each finger are robosuite's (``models/assets/grippers/rethink_gripper.xml``); its damping lets a finger
move at 0.2 m/s. The gain presses whatever is 5 mm thicker than the gap of closed fingertips with the whole
force. The fingertips do not meet: they close to 14 mm, and open to 79 mm.
"""

from typing import Any

from envs.scenario import GripperCfg, JointCfg

_FINGER: dict[str, Any] = {
    "kp": 8000.0,
    "kd": 0.0,
    "force_limit": 20.0,
    "range": (-0.0115, 0.020833),
    "default": 0.020833,
}

_FINGERS = (
    JointCfg(name="gripper/l_finger_joint", **_FINGER),
    JointCfg(name="gripper/r_finger_joint", **_FINGER),
)

RETHINK_GRIPPER = GripperCfg(
    mjcf="envs:robots/rethink_gripper.xml",
    root="rethink_gripper",
    ee_site="gripper/grip_site",
    joints=_FINGERS,
    gripper_joints=tuple(joint.name for joint in _FINGERS),
    opening_m=0.0788,
    closed_m=0.0141,
)
