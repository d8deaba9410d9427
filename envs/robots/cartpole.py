"""A pole that turns freely on a cart on a rail, as data: ``cartpole.xml`` beside this file.

Isaac Lab's model is a file of NVIDIA's asset server; its dimensions are not in its repository. Here a cart of
1 kg carries a pole of 1 kg and 1 m. Control is Isaac Lab's (``isaaclab_assets/robots/cartpole.py`` and
``classic/cartpole/cartpole_env_cfg.py``, BSD 3-Clause): an action of 1 pushes with 100 N, against a damping
of 10 N·s/m.
"""

from math import pi

from envs.scenario import JointCfg, RobotCfg

FORCE_N = 100.0

CARTPOLE = RobotCfg(
    name="cartpole",
    mjcf="envs:robots/cartpole.xml",
    root="rail",
    joints=(
        JointCfg(
            name="slider_to_cart",
            kp=0.0,
            kd=10.0,
            force_limit=400.0,
            range=(-4.0, 4.0),
            default=0.0,
            target_range=(-FORCE_N, FORCE_N),
            drive="torque",
        ),
        JointCfg(
            name="cart_to_pole",
            kp=0.0,
            kd=0.0,
            force_limit=0.0,
            range=(-8.0 * pi, 8.0 * pi),
            default=0.0,
            driven=False,
        ),
    ),
    ee_site="pole",
    pos=(0.0, 0.0, 2.0),
    gravity_compensated=False,
)
