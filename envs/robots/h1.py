"""Unitree H1 without hands, as HumanoidBench has it.

HumanoidBench (Sferrazza et al., RSS 2024, arXiv:2403.10506, MIT) is the reference: its repository's
``assets/robots/h1_pos.xml``. Links and meshes come from the package ``robosuite_models`` (Unitree's, BSD
3-Clause), whose numbers differ; the published ones below replace them:

- masses of pelvis and torso (there 1.39 and 7.789 kg), and of the feet (0.446 kg) with their inertias;
- orientation of the knees' inertias (there not a unit quaternion: 0.177852 for 0.777852);
- range of the hip's pitch (there ±1.57 rad), damping, armature and dry friction of every joint;
- the feet's touched shape: HumanoidBench's are 30 cm long and 3 cm wide, Unitree's 24 by 8 cm. Its convex
  hull is given by 44 corners that stay within 0.8 mm of it; images show Unitree's feet;
- a body ``base`` of 1.45 kg that carries the pelvis there is left out.

:func:`h1_of` reads HumanoidBench's own folder instead, unchanged.
"""

import dataclasses
from pathlib import Path

from envs.scenario import BodyCfg, JointCfg, RobotCfg, SiteCfg, Vec3

SERVOS = (
    # name, kp (N·m/rad), kd (N·m·s/rad), force limit (N·m), range (rad), rest (rad)
    ("left_hip_yaw", 200.0, 5.0, 200.0, (-0.43, 0.43), 0.0),
    ("left_hip_roll", 200.0, 5.0, 200.0, (-0.43, 0.43), 0.0),
    ("left_hip_pitch", 200.0, 5.0, 200.0, (-3.14, 2.53), -0.4),
    ("left_knee", 300.0, 6.0, 300.0, (-0.26, 2.05), 0.8),
    ("left_ankle", 40.0, 2.0, 40.0, (-0.87, 0.52), -0.4),
    ("right_hip_yaw", 200.0, 5.0, 200.0, (-0.43, 0.43), 0.0),
    ("right_hip_roll", 200.0, 5.0, 200.0, (-0.43, 0.43), 0.0),
    ("right_hip_pitch", 200.0, 5.0, 200.0, (-3.14, 2.53), -0.4),
    ("right_knee", 300.0, 6.0, 300.0, (-0.26, 2.05), 0.8),
    ("right_ankle", 40.0, 2.0, 40.0, (-0.87, 0.52), -0.4),
    ("torso", 300.0, 6.0, 200.0, (-2.35, 2.35), 0.0),
    ("left_shoulder_pitch", 100.0, 2.0, 40.0, (-2.87, 2.87), 0.0),
    ("left_shoulder_roll", 100.0, 2.0, 40.0, (-0.34, 3.11), 0.0),
    ("left_shoulder_yaw", 100.0, 2.0, 18.0, (-1.3, 4.45), 0.0),
    ("left_elbow", 100.0, 2.0, 18.0, (-1.25, 2.61), 0.0),
    ("right_shoulder_pitch", 100.0, 2.0, 40.0, (-2.87, 2.87), 0.0),
    ("right_shoulder_roll", 100.0, 2.0, 40.0, (-3.11, 0.34), 0.0),
    ("right_shoulder_yaw", 100.0, 2.0, 18.0, (-4.45, 1.3), 0.0),
    ("right_elbow", 100.0, 2.0, 18.0, (-1.25, 2.61), 0.0),
)
"""Position actuators and the start posture of the tasks, in the order of the published ``qpos``."""

_FOOT_CORNERS: tuple[Vec3, ...] = (
    (-0.1, 0.012, -0.067),
    (-0.0996, 0.0135, -0.0613),
    (-0.0989, 0.012, -0.0594),
    (-0.0989, 0.013, -0.0687),
    (-0.0975, 0.0149, -0.0609),
    (-0.0975, 0.015, -0.0668),
    (-0.0951, 0.0143, -0.0689),
    (-0.095, 0.012, -0.07),
    (-0.0063, 0.01, 0.009),
    (-0.001, 0.01, 0.011),
    (-0.0009, 0.011, 0.0103),
    (0.0028, 0.0105, 0.0105),
    (0.1726, 0.015, -0.0475),
    (0.1749, 0.012, -0.0456),
    (0.1753, 0.0143, -0.047),
    (0.1948, 0.012, -0.07),
    (0.1949, 0.0143, -0.0689),
    (0.1972, 0.015, -0.0664),
    (0.1977, 0.0148, -0.0609),
    (0.1984, 0.0135, -0.0681),
    (0.1993, 0.0125, -0.0598),
    (0.2, 0.012, -0.0664),
)
"""Left half of the hull of ``h1/assets/left_ankle_link.stl``, m; the right half is its mirror image."""


def _foot(side: str) -> BodyCfg:
    return BodyCfg(
        name=f"{side}_ankle_link",
        mass_kg=0.552448,
        com=(0.048568, 0.0, -0.045609),
        inertia=(0.00362, 0.00355701, 0.000149987),
        inertia_rot=(0.489385, 0.510394, 0.510394, 0.489385),
        hull=(*_FOOT_CORNERS, *((x, -y, z) for x, y, z in _FOOT_CORNERS)),
    )


_BODIES = (
    BodyCfg(
        name="pelvis",
        mass_kg=5.39,
        com=(-0.0002, 4e-05, -0.04522),
        inertia=(0.0490211, 0.0445821, 0.00824619),
        inertia_rot=(0.498303, 0.499454, -0.500496, 0.501741),
    ),
    BodyCfg(
        name="torso_link",
        mass_kg=17.789,
        com=(0.000489, 0.002797, 0.20484),
        inertia=(0.487315, 0.409628, 0.127837),
        inertia_rot=(0.999989, -0.00130808, -0.00282289, -0.00349105),
    ),
    BodyCfg(
        name="left_knee_link",
        mass_kg=1.721,
        com=(-0.00136, -0.00512, -0.1384),
        inertia=(0.0125237, 0.0123104, 0.0019428),
        inertia_rot=(0.626132, -0.034227, -0.0416277, 0.777852),
    ),
    BodyCfg(
        name="right_knee_link",
        mass_kg=1.721,
        com=(-0.00136, 0.00512, -0.1384),
        inertia=(0.0125237, 0.0123104, 0.0019428),
        inertia_rot=(0.777852, -0.0416277, -0.034227, 0.626132),
    ),
    _foot("left"),
    _foot("right"),
)


def _name_in_the_package(joint: str) -> str:
    leg = any(part in joint for part in ("hip", "knee", "ankle"))
    return f"{joint.replace('_', '_leg_', 1) if leg else joint}_joint"


def _joints(own_names: bool) -> tuple[JointCfg, ...]:
    return tuple(
        JointCfg(
            name=name if own_names else _name_in_the_package(name),
            kp=kp,
            kd=kd,
            force_limit=force,
            range=limits,
            default=rest,
            damping=1.0,
            armature=0.1,
            frictionloss=0.0,
        )
        for name, kp, kd, force, limits, rest in SERVOS
    )


STAND_HEIGHT_M = 0.98
"""Height of the pelvis at the start of the tasks."""

H1 = RobotCfg(
    name="h1",
    mjcf="robosuite_models:assets/robots/h1/robot.xml",
    root="pelvis",
    joints=_joints(own_names=False),
    ee_site="head",
    bodies=_BODIES,
    sites=(SiteCfg(name="head", body="torso_link", pos=(0.0, 0.0, 0.7)),),
    pos=(0.0, 0.0, STAND_HEIGHT_M),
    fixed_base=False,
    gravity_compensated=False,
)


def h1_of(folder: str) -> RobotCfg:
    """Returns the robot of HumanoidBench's own folder of assets; an empty name is :data:`H1`."""
    if not folder:
        return H1
    file = str(Path(folder) / "robots" / "h1_pos.xml")
    return dataclasses.replace(H1, mjcf=file, joints=_joints(own_names=True), bodies=(), sites=())
