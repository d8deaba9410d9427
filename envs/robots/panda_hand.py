"""The Franka hand from robosuite's MJCF.

Its site ``grip_site`` has the same axes on every arm: fingers open along x, z points forward.
"""

from typing import Any

from envs.scenario import GripperCfg, JointCfg

_FINGER: dict[str, Any] = {
    "kp": 1000.0,
    "kd": 60.0,
    "force_limit": 40.0,
    "range": (0.0, 0.04),
    "default": 0.04,
    "damping": 10.0,
    "armature": 0.1,
    "frictionloss": 0.0,
}

PANDA_FINGERS = (
    JointCfg(name="gripper/finger_joint1", **_FINGER),
    JointCfg(name="gripper/finger_joint2", flip=True, **_FINGER),
)
"""Both fingers: metres from closed, each drives one."""

PANDA_HAND = GripperCfg(
    mjcf="robosuite:models/assets/grippers/panda_gripper.xml",
    root="right_gripper",
    ee_site="gripper/grip_site",
    joints=PANDA_FINGERS,
    gripper_joints=tuple(joint.name for joint in PANDA_FINGERS),
)
