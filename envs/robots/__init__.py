"""Robots: one file each, constants with their sources, no logic.

Arms of :data:`ARMS` carry the Franka hand, and as ``<arm>_<gripper>`` the Robotiq 2F-85 and the gripper that
their maker sells with them. A further arm or gripper is one row.
"""

from typing import NamedTuple

from envs.core.registry import Registry
from envs.scenario import GripperCfg, RobotCfg

ROBOTS: Registry[RobotCfg] = Registry(
    "robot",
    group="roboverse.robots",
    # ManiSkill, robosuite and LeRobot call it so.
    other_names={"panda": "franka", "franka_panda": "franka"},
)
GRIPPERS: Registry[GripperCfg] = Registry("gripper")
ANY_ARM = "any arm"
"""Tag of grippers that every arm is listed with; the others are some arm's ``own``."""

GRIPPERS.add("2f85", "envs.robots.robotiq_2f85:ROBOTIQ_2F85", tags={ANY_ARM}, summary="the Robotiq 2F-85")
GRIPPERS.add(
    "rethink",
    "envs.robots.rethink_gripper:RETHINK_GRIPPER",
    summary="its maker's parallel gripper",
)
GRIPPERS.add(
    "three_finger",
    "envs.robots.jaco_three_finger:JACO_THREE_FINGER",
    summary="its maker's gripper of three fingers",
)
GRIPPERS.add(
    "xarm_gripper",
    "envs.robots.xarm_gripper:XARM_GRIPPER",
    summary="its maker's gripper (roboverse assets get xarm_gripper)",
)


class _Arm(NamedTuple):
    """An arm: its name with the Franka hand, its target, what it is, and the gripper of its maker."""

    name: str
    target: str
    summary: str
    own: str = ""


ARMS = {
    "franka": _Arm("franka", "franka:FRANKA", "Franka Emika Panda, 7 joints"),
    "iiwa": _Arm("iiwa", "robosuite_arms:IIWA", "KUKA LBR iiwa 14, 7 joints"),
    "ur5e": _Arm("ur5e", "robosuite_arms:UR5E", "Universal Robots UR5e, 6 joints"),
    "sawyer": _Arm("sawyer_panda", "robosuite_arms:SAWYER_PANDA", "Rethink Sawyer, 7 joints", "rethink"),
    "kinova3": _Arm("kinova3", "robosuite_arms:KINOVA3", "Kinova Gen3, 7 joints"),
    "xarm7": _Arm(
        "xarm7", "xarm7:XARM7", "UFACTORY xArm7 (roboverse assets get xarm7), 7 joints", "xarm_gripper"
    ),
    "jaco": _Arm("jaco", "robosuite_arms:JACO", "Kinova Jaco, 7 joints", "three_finger"),
}
"""Arms that take any gripper."""

for _name, _arm in ARMS.items():
    _hand = f"{_arm.summary}, with the Franka hand"
    ROBOTS.add(_arm.name, f"envs.robots.{_arm.target}", tags={"arm"}, summary=_hand)
    for _gripper in (*GRIPPERS.names(ANY_ARM), *([_arm.own] if _arm.own else [])):
        ROBOTS.add(
            f"{_name}_{_gripper}",
            f"envs.robots.with_grippers:{_name.upper()}_{_gripper.upper()}",
            tags={"arm"},
            summary=f"{_arm.summary}, with {GRIPPERS.entry(_gripper).summary}",
        )
ROBOTS.add(
    "franka_stick", "envs.robots.franka:FRANKA_STICK", summary="Franka Emika Panda with a stick as its hand"
)
ROBOTS.add("h1", "envs.robots.h1:H1", extra="humanoid", summary="Unitree H1, a humanoid without hands")
ROBOTS.add(
    "h1_hand",
    "envs.robots.h1_hand:H1_HAND",
    summary="Unitree H1 with two Shadow hands (roboverse assets get humanoid_bench), 69 joints, 61 driven",
)
ROBOTS.add(
    "sawyer", "envs.robots.sawyer:SAWYER", extra="metaworld", summary="Rethink Sawyer with a parallel gripper"
)
ROBOTS.add(
    "so101",
    "envs.robots.so101:SO101",
    tags={"arm"},
    summary="SO-101 of LeRobot, 5 joints and a gripper, in degrees and percent",
)
ROBOTS.add("ant", "envs.robots.ant:ANT", summary="a ball on four legs of two joints")
ROBOTS.add("cartpole", "envs.robots.cartpole:CARTPOLE", summary="a free pole on a cart on a rail")
