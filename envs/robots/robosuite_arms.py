"""Arms of robosuite's wheel, with the Franka hand: KUKA iiwa, UR5e, Rethink Sawyer, Kinova Gen3 and Jaco.

Kinematics, masses, meshes and joint ranges are robosuite's (``models/assets/robots/<arm>/robot.xml``); a
joint without limits there gets two turns. Force limits are the ranges of the file's torque motors. Rest
postures are ``init_qpos`` of ``models/robots/manipulators/<arm>_robot.py``; a task computes its own from
where the hand has to be.

Position actuators as :mod:`envs.robots.franka` has them: gains of 4000 N·m/rad for the joints near the base
and 2000 for those of the wrist, damping of a tenth.

The motors of Kinova's arms, Gen3 and Jaco, are weak and their wrists are light: damping kd turns the whole
force F of a motor round once a joint is F / kd faster than it should be, and a physics step dt at that force
changes its speed by F dt / I. Where that is more than 2 F / kd the joint chatters. So their joints get a
rotor inertia of I = kd dt / 2 with dt = 2 ms: 0.4 and 0.2 kg·m², as of a rotor of 4e-5 or 2e-5 kg·m² behind
a gear of 1:100.
"""

from collections.abc import Sequence
from math import pi

from envs.robots.panda_hand import PANDA_HAND
from envs.scenario import JointCfg, RobotCfg

ENDLESS = (-2 * pi, 2 * pi)

_BENT = 0.3
"""Least bend of Kinova's elbow, rad; its file allows both sides. A straight elbow is singular: at a pose just
out of reach, inverse kinematics throws it from side to side. The bend costs 8 mm of reach."""


def position_arm(
    name: str,
    mjcf: str,
    root: str,
    joints: Sequence[str],
    limits: Sequence[tuple[float, float]],
    forces_n_m: Sequence[float],
    rest: Sequence[float],
    *,
    hollow_meshes: bool = False,
    apart: tuple[tuple[str, str], ...] = (),
    rotor_inertia: tuple[float | None, float | None] = (None, None),
) -> RobotCfg:
    """Returns an arm; its last three joints are those of the wrist.

    Args:
        name: Its name.
        mjcf: Asset reference of its file, whose body ``right_hand`` is its flange.
        root: Body of the file that is the base.
        joints: Names of its joints.
        limits: Their ranges, rad.
        forces_n_m: Their force limits.
        rest: Their rest positions, rad.
        hollow_meshes: See :class:`~envs.scenario.RobotCfg`.
        apart: Likewise.
        rotor_inertia: Armature of the joints near the base and of those of the wrist, kg·m²; None keeps the
            file's.
    """
    wrist = len(joints) - 3
    return RobotCfg(
        name=name,
        mjcf=mjcf,
        root=root,
        joints=tuple(
            JointCfg(
                name=joint,
                kp=4000.0 if index < wrist else 2000.0,
                kd=400.0 if index < wrist else 200.0,
                force_limit=force,
                range=between,
                default=angle,
                armature=rotor_inertia[index >= wrist],
            )
            for index, (joint, between, force, angle) in enumerate(
                zip(joints, limits, forces_n_m, rest, strict=True)
            )
        ),
        gripper_mount="right_hand",
        ee_site="right_hand",
        hollow_meshes=hollow_meshes,
        apart=apart,
    ).with_gripper(PANDA_HAND, name)


def _robosuite(folder: str) -> tuple[str, str]:
    """Returns a file of robosuite's wheel, and its base."""
    return f"robosuite:models/assets/robots/{folder}/robot.xml", "base"


IIWA = position_arm(
    "iiwa",
    *_robosuite("iiwa"),
    [f"joint_{i}" for i in range(1, 8)],
    [*[(-2.96706, 2.96706), (-2.0944, 2.0944)] * 3, (-3.05433, 3.05433)],
    (176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0),
    (0.0, 0.65, 0.0, -1.89, 0.0, 0.6, 0.0),
)

UR5E = position_arm(
    "ur5e",
    *_robosuite("ur5e"),
    [f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")],
    [ENDLESS, ENDLESS, (-pi, pi), ENDLESS, ENDLESS, ENDLESS],
    (150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    (-0.47, -1.735, 2.48, -2.275, -1.59, -1.991),
)

SAWYER_PANDA = position_arm(
    "sawyer_panda",
    *_robosuite("sawyer"),
    [f"right_j{i}" for i in range(7)],
    [
        *((-3.0503, 3.0503), (-3.8095, 2.2736), (-3.0426, 3.0426), (-3.0439, 3.0439)),
        *((-2.9761, 2.9761), (-2.9761, 2.9761), (-4.7124, 4.7124)),
    ],
    (80.0, 80.0, 40.0, 40.0, 9.0, 9.0, 9.0),
    (0.0, -1.18, 0.0, 2.18, 0.0, 0.57, -1.57),
    hollow_meshes=True,
    # The cylinder round the base and the sphere of the first link touch in one point, and rub.
    apart=(("right_arm_base_link", "right_l0"),),
)

KINOVA3 = position_arm(
    "kinova3",
    *_robosuite("kinova3"),
    [f"Actuator{i}" for i in range(1, 8)],
    [ENDLESS, (-2.41, 2.41), ENDLESS, (_BENT, 2.66), ENDLESS, (-2.23, 2.23), ENDLESS],
    (32.0, 32.0, 32.0, 32.0, 32.0, 13.0, 13.0),
    (0.0, 0.65, 0.0, 1.89, 0.0, 0.6, -pi / 2),
    rotor_inertia=(0.4, 0.2),
)

JACO = position_arm(
    "jaco",
    *_robosuite("jaco"),
    [f"j2s7s300_joint_{i}" for i in range(1, 8)],
    [
        *(ENDLESS, (0.820305, 5.46288), ENDLESS, (0.523599, 5.75959)),
        *(ENDLESS, (1.13446, 5.14872), ENDLESS),
    ],
    (30.5, 30.5, 30.5, 30.5, 30.5, 6.8, 6.8),
    (3.192, 3.68, 0.0, 1.17, 0.05, 3.76, 3.142),
    rotor_inertia=(0.4, 0.2),
)
