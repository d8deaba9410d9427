"""Franka Emika Panda with the Franka hand, from robosuite's MJCF.

Kinematics, masses and meshes are robosuite's (``models/assets/robots/panda/robot.xml``). Its torque
motors are replaced by joint-position actuators.

- Joint limits: robosuite's file, which are the maker's (Franka Control Interface documentation,
  "Robot limits"); force limits 87 N·m and 12 N·m from the same page.
- Rest posture: ManiSkill's PickCube, ``[0, π/8, 0, -5π/8, 0, 3π/4, π/4, 0.04, 0.04]``.
- Gains: position gains as in MuJoCo Menagerie's ``franka_emika_panda/panda.xml`` (4500, 4500, 3500,
  3500, 2000, 2000, 2000); its damping gains (a tenth of them) suit the real links' inertias, and are
  kept, for they leave robosuite's heavier links well damped.
"""

from dataclasses import replace
from math import pi

from envs.robots.panda_hand import PANDA_FINGERS, PANDA_HAND
from envs.scenario import GeomCfg, JointCfg, RobotCfg, SiteCfg

_ARM = (
    # kp, kd, force limit, range, rest
    (4500.0, 450.0, 87.0, (-2.8973, 2.8973), 0.0),
    (4500.0, 450.0, 87.0, (-1.7628, 1.7628), pi / 8),
    (3500.0, 350.0, 87.0, (-2.8973, 2.8973), 0.0),
    (3500.0, 350.0, 87.0, (-3.0718, -0.0698), -5 * pi / 8),
    (2000.0, 200.0, 12.0, (-2.8973, 2.8973), 0.0),
    (2000.0, 200.0, 12.0, (-0.0175, 3.7525), 3 * pi / 4),
    (2000.0, 200.0, 12.0, (-2.8973, 2.8973), pi / 4),
)

FRANKA = RobotCfg(
    name="franka",
    mjcf="robosuite:models/assets/robots/panda/robot.xml",
    root="base",
    joints=tuple(
        JointCfg(name=f"joint{i + 1}", kp=kp, kd=kd, force_limit=force, range=limits, default=rest)
        for i, (kp, kd, force, limits, rest) in enumerate(_ARM)
    ),
    gripper_mount="right_hand",
    ee_site="right_hand",
).with_gripper(PANDA_HAND, "franka")

_TORQUE_LIMITS = (80.0, 80.0, 80.0, 80.0, 80.0, 12.0, 12.0)
"""``ctrlrange`` of the motors, N·m, in robosuite's file."""

_TORQUE_ARM = tuple(
    replace(
        joint,
        kp=0.0,
        kd=0.0,
        drive="torque",
        force_limit=limit,
        target_range=(-limit, limit),
        armature=5.0 / (index + 1),
        frictionloss=0.1,
    )
    for index, (joint, limit) in enumerate(zip(FRANKA.joints, _TORQUE_LIMITS, strict=False))
)

FRANKA_TORQUE = replace(
    FRANKA,
    joints=(
        *_TORQUE_ARM,
        *(
            replace(finger, kd=0.0, force_limit=20.0, damping=100.0, armature=1.0, frictionloss=1.0)
            for finger in PANDA_FINGERS
        ),
    ),
    gravity_compensated=False,
)
"""The same arm as robosuite 1.4 drives it, for :class:`~envs.operational_space.OperationalSpaceController`.

Motors, fingers' actuators and their joints are those of robosuite's files; rotor inertias ``5 / (i + 1)``
kg·m² and the dry friction of 0.1 N·m are what its ``RobotModel`` adds to joints that name none.
"""

STICK_M = 0.142
"""Length of the stick from the flange. In ManiSkill 3's start of PushT (``tabletop/push_t.py``) its end is
where that file has it, at (-0.321, 0.284, 0.024) m, within 1 mm."""

_RADIUS_M = 0.01

FRANKA_STICK = replace(
    FRANKA,
    name="franka_stick",
    joints=FRANKA.joints[:7],
    gripper_mjcf=None,
    gripper_root=None,
    gripper_joints=(),
    tool=(
        GeomCfg(
            shape="cylinder",
            size=(_RADIUS_M, STICK_M / 2),
            pos=(0.0, 0.0, STICK_M / 2),
            rgba=(0.35, 0.35, 0.38, 1.0),
            mass_kg=0.1,
        ),
    ),
    sites=(SiteCfg(name="tip", body="tool", pos=(0.0, 0.0, STICK_M)),),
    ee_site="tip",
)
"""The arm with a stick in place of its hand, as ManiSkill 3's ``panda_stick``; the stick is 2 cm thick."""
