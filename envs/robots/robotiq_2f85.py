"""Robotiq 2F-85: two fingers of four bars each and one motor, with the meshes of robosuite's wheel.

The file ``robotiq_2f85.xml`` beside this one says where frames and shapes are from. The bars of a finger are
a parallelogram: one angle turns both knuckles, the same angle backwards turns the fingertip, which stays
parallel to the other one, and the fingers mirror each other (mimic joints of the maker's ROS driver). A real
fingertip also gives way, and wraps round what it touches above the pad; these ties leave that out.

Figures of the maker's data sheet: a stroke of 85 mm, a grip of 20 to 235 N, 20 to 150 mm/s. From open to
closed the knuckle turns by 0.8 rad.

- Force limit: 5 N·m, Menagerie's (``robotiq_2f85/2f85.xml``), shared by both fingers: 46 N round a cube of
  4 cm, where a radian is 0.109 m between the fingertips. The Franka hand presses with 40 N.
- Damping: the joint's takes the whole torque at the fastest closing, 150 mm/s, 1.41 rad/s.
- Rotor inertia: Menagerie's 0.005 kg·m². The bars weigh 16 to 31 g: the tied joints get a fifth of it, or a
  grip would bend the ties.
"""

from typing import Any

from envs.scenario import GripperCfg, JointCfg

_SHUT_RAD = 0.8
_TORQUE_N_M, _FASTEST_RAD_S = 5.0, 1.41

_FINGER = "gripper/finger_joint"

_TIED: dict[str, Any] = {
    "kp": 0.0,
    "kd": 0.0,
    "force_limit": 0.0,
    "default": 0.0,
    "armature": 0.001,
    "driven": False,
}


def _tied(name: str, limits: tuple[float, float], ratio: float) -> JointCfg:
    return JointCfg(name=f"gripper/{name}", range=limits, follows=(_FINGER, ratio), **_TIED)


ROBOTIQ_2F85 = GripperCfg(
    mjcf="envs:robots/robotiq_2f85.xml",
    root="robotiq_2f85",
    ee_site="gripper/grip_site",
    joints=(
        JointCfg(
            name=_FINGER,
            kp=100.0,
            kd=0.0,
            force_limit=_TORQUE_N_M,
            range=(0.0, _SHUT_RAD),
            default=0.0,
            damping=_TORQUE_N_M / _FASTEST_RAD_S,
            armature=0.005,
        ),
        _tied("left_inner_finger_joint", (-0.8757, 0.8757), -1.0),
        _tied("left_inner_knuckle_joint", (0.0, 0.8757), 1.0),
        _tied("right_outer_knuckle_joint", (0.0, _SHUT_RAD), 1.0),
        _tied("right_inner_finger_joint", (-0.8757, 0.8757), -1.0),
        _tied("right_inner_knuckle_joint", (0.0, 0.8757), 1.0),
    ),
    gripper_joints=(_FINGER,),
    range=((_SHUT_RAD, 0.0),),
    opening_m=0.085,
)
