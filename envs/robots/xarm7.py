"""UFACTORY xArm7 with the Franka hand; its meshes are the asset folder ``xarm7``.

``xarm7.xml`` beside this file says where frames, masses and shapes are from. Joint ranges and force limits
are those of the maker's ``xarm7.urdf.xacro``. Its motors are weak and its links are light, as those of
Kinova's arms: gains and rotor inertias are theirs (:mod:`envs.robots.robosuite_arms`).

Rest posture: MuJoCo Menagerie's (``ufactory_xarm7/xarm7_nohand.xml``, keyframe ``home``).
"""

from math import pi

from envs.robots.robosuite_arms import ENDLESS, position_arm

XARM7 = position_arm(
    "xarm7",
    "envs:robots/xarm7.xml",
    "link_base",
    [f"joint{i}" for i in range(1, 8)],
    [ENDLESS, (-2.059, 2.0944), ENDLESS, (-0.19198, 3.927), ENDLESS, (-1.69297, pi), ENDLESS],
    (50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0),
    (0.0, -0.247, 0.0, 0.909, 0.0, 1.15644, 0.0),
    # The hulls of the base and of the first link overlap where the joint is.
    apart=(("link_base", "link1"),),
    rotor_inertia=(0.4, 0.2),
)
