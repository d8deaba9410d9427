"""UFACTORY's xArm Gripper: two fingers of four bars each and one motor; its meshes are ``xarm_gripper``.

``xarm_gripper.xml`` beside this file says where frames, masses and shapes are from. One angle turns all bars
(mimic joints of the maker's ``xarm_gripper.urdf.xacro``): the knuckles one way and the fingertips the other,
which stay parallel. From open to closed it is 0.85 rad, at 2 rad/s at most, both from that file.

- Force limit: that file's 50 N·m would press with 450 N. It is that of the Robotiq 2F-85, 5 N·m, which a
  lever of 0.11 m makes 45 N round a cube of 4 cm; the Franka hand presses with 40 N.
- Damping: the joint's takes the whole torque at the fastest closing.
- Rotor inertia: as of :mod:`envs.robots.robotiq_2f85`, whose bars are as light.
"""

from typing import Any

from envs.scenario import GripperCfg, JointCfg

_SHUT_RAD = 0.85
_TORQUE_N_M, _FASTEST_RAD_S = 5.0, 2.0

_DRIVE = "gripper/drive_joint"

_TIED: dict[str, Any] = {
    "kp": 0.0,
    "kd": 0.0,
    "force_limit": 0.0,
    "default": 0.0,
    "range": (0.0, _SHUT_RAD),
    "armature": 0.001,
    "driven": False,
    "follows": (_DRIVE, 1.0),
}

XARM_GRIPPER = GripperCfg(
    mjcf="envs:robots/xarm_gripper.xml",
    root="xarm_gripper",
    ee_site="gripper/grip_site",
    joints=(
        JointCfg(
            name=_DRIVE,
            kp=100.0,
            kd=0.0,
            force_limit=_TORQUE_N_M,
            range=(0.0, _SHUT_RAD),
            default=0.0,
            damping=_TORQUE_N_M / _FASTEST_RAD_S,
            armature=0.005,
        ),
        JointCfg(name="gripper/left_finger_joint", **_TIED),
        JointCfg(name="gripper/left_inner_knuckle_joint", **_TIED),
        JointCfg(name="gripper/right_outer_knuckle_joint", **_TIED),
        JointCfg(name="gripper/right_finger_joint", **_TIED),
        JointCfg(name="gripper/right_inner_knuckle_joint", **_TIED),
    ),
    gripper_joints=(_DRIVE,),
    range=((_SHUT_RAD, 0.0),),
    opening_m=0.089,
)
