"""Robots: one file each, constants with their sources, no logic."""

from envs.core.registry import Registry
from envs.scenario import RobotCfg

ROBOTS: Registry[RobotCfg] = Registry("robot", group="roboverse.robots")
ROBOTS.add(
    "franka",
    "envs.robots.franka:FRANKA",
    tags={"arm"},
    summary="Franka Emika Panda, 7 joints, with its parallel gripper",
)
ROBOTS.add(
    "franka_stick", "envs.robots.franka:FRANKA_STICK", summary="Franka Emika Panda with a stick as its hand"
)
ROBOTS.add("h1", "envs.robots.h1:H1", extra="humanoid", summary="Unitree H1, a humanoid without hands")
ROBOTS.add(
    "sawyer", "envs.robots.sawyer:SAWYER", extra="metaworld", summary="Rethink Sawyer with a parallel gripper"
)
for _name, _summary in (
    ("iiwa", "KUKA LBR iiwa 14, 7 joints"),
    ("ur5e", "Universal Robots UR5e, 6 joints"),
    ("sawyer_panda", "Rethink Sawyer, 7 joints"),
    ("kinova3", "Kinova Gen3, 7 joints"),
    ("jaco", "Kinova Jaco, 7 joints"),
):
    _target = f"envs.robots.robosuite_arms:{_name.upper()}"
    ROBOTS.add(_name, _target, tags={"arm"}, summary=f"{_summary}, with the Franka hand")
ROBOTS.add(
    "so101",
    "envs.robots.so101:SO101",
    tags={"arm"},
    summary="SO-101 of LeRobot, 5 joints and a gripper, in degrees and percent",
)
ROBOTS.add("ant", "envs.robots.ant:ANT", summary="a ball on four legs of two joints")
ROBOTS.add("cartpole", "envs.robots.cartpole:CARTPOLE", summary="a free pole on a cart on a rail")
