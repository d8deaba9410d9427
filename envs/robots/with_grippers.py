"""Arms with a gripper of :data:`envs.robots.GRIPPERS`: ``UR5E_2F85`` is the arm ``ur5e`` with ``2f85``.

The hand in robosuite's Franka hand has an inertia of 0.05 kg·m², many times that of a real gripper, and keeps
the joints of a wrist from chattering. Here each joint whose rotor has no inertia gets the one that
:mod:`envs.robots.robosuite_arms` gives Kinova's, ``kd dt / 2`` with dt = 2 ms: no gripper is too light then.
"""

from dataclasses import replace
from functools import cache

from envs.robots import ARMS, GRIPPERS, ROBOTS
from envs.scenario import JointCfg, RobotCfg

_TIMESTEP_S = 0.002


@cache
def __getattr__(name: str) -> RobotCfg:
    arm, _, gripper = name.lower().partition("_")
    if arm not in ARMS or gripper not in GRIPPERS:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    bare = ROBOTS.get(ARMS[arm].name)
    steady = replace(bare, joints=tuple(map(_with_rotor, bare.joints)))
    return steady.with_gripper(GRIPPERS.get(gripper), f"{arm}_{gripper}")


def _with_rotor(joint: JointCfg) -> JointCfg:
    return joint if joint.armature is not None else replace(joint, armature=joint.kd * _TIMESTEP_S / 2)
