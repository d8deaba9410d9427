"""The ant: a ball on four legs of two joints, from Gymnasium's MJCF, with the numbers of Isaac Gym's.

Shapes are those of ``gymnasium/envs/mujoco/assets/ant.xml`` (MIT). Isaac Lab's ant (``isaaclab_assets/robots/
ant.py``, BSD 3-Clause) is Isaac Gym's ``assets/mjcf/nv_ant.xml``, which has the same shapes and densities;
its ranges, armature, damping and gear of 15 N·m replace Gymnasium's. Isaac Lab gives half of that gear to an
action of 1: 7.5 N·m.
"""

from math import pi, radians

from envs.scenario import JointCfg, RobotCfg

TORQUE_N_M = 7.5

_ANKLE_REST = pi / 4

_ANKLES = {1: 1.0, 2: -1.0, 3: -1.0, 4: 1.0}
"""Leg to the sign of its ankle's positions."""


def _joint(name: str, limits: tuple[float, float], rest: float) -> JointCfg:
    return JointCfg(
        name=name,
        kp=0.0,
        kd=0.0,
        force_limit=30.0,
        range=(radians(limits[0]), radians(limits[1])),
        default=rest,
        damping=0.1,
        armature=0.01,
        target_range=(-TORQUE_N_M, TORQUE_N_M),
        drive="torque",
    )


def _leg(index: int) -> tuple[JointCfg, JointCfg]:
    sign = _ANKLES[index]
    low, high = sorted((30.0 * sign, 100.0 * sign))
    return _joint(f"hip_{index}", (-40.0, 40.0), 0.0), _joint(
        f"ankle_{index}", (low, high), sign * _ANKLE_REST
    )


ANT = RobotCfg(
    name="ant",
    mjcf="gymnasium:envs/mujoco/assets/ant.xml",
    root="torso",
    joints=tuple(joint for index in _ANKLES for joint in _leg(index)),
    ee_site="torso",
    pos=(0.0, 0.0, 0.5),
    fixed_base=False,
    gravity_compensated=False,
)
