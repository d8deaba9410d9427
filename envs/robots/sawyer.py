"""Rethink Sawyer with a parallel gripper, from Meta-World's MJCF.

Meta-World (Yu et al., "Meta-World", CoRL 2019, arXiv:1910.10897) does not drive the arm's joints: a soft
weld pulls the hand to a mocap body, and the arm follows. So these joints are part of the state and
have no actuator; the scenario has to bring an object that ``pulls`` :data:`SAWYER_HAND`.

- Everything of the arm is the file's (``assets/objects/assets/xyz_base.xml``): joint ranges, damping,
  inertias.
- Fingers: position actuators of gain 400 N/m whose targets lie in [-1, 1] m, far beyond the fingers'
  ranges, and so are forces rather than positions (``assets/sawyer_xyz/*.xml``).
- Rest posture: where Meta-World's ``_reset_hand`` leaves the arm for the hand at (0, 0.6, 0.2) m.
"""

from envs.scenario import JointCfg, RobotCfg

FINGER_KP = 400.0

_NO_LIMIT_N = 1e4
"""More than the actuators ever need: the file sets no limit."""

_ARM = (
    # range, rest
    ((-3.0503, 3.0503), 1.8867),
    ((-3.8, -0.5), -0.5884),
    ((-3.0426, 3.0426), 0.7839),
    ((-3.0439, 3.0439), 1.5007),
    ((-2.9761, 2.9761), -0.7140),
    ((-2.9761, 2.9761), 1.1054),
    ((-4.7124, 4.7124), 1.6032),
)

SAWYER_HAND = "hand"
"""Body of the hand."""

SAWYER_FINGERS = ("r_close", "l_close")


def _finger(name: str, limits: tuple[float, float]) -> JointCfg:
    return JointCfg(
        name=name,
        kp=FINGER_KP,
        kd=0.0,
        force_limit=_NO_LIMIT_N,
        range=limits,
        default=0.0,
        target_range=(-1.0, 1.0),
    )


SAWYER = RobotCfg(
    name="sawyer",
    mjcf="metaworld:assets/sawyer_xyz/sawyer_reach_v3.xml",
    root="base",
    joints=(
        *(
            JointCfg(
                name=f"right_j{index}",
                kp=0.0,
                kd=0.0,
                force_limit=0.0,
                range=limits,
                default=rest,
                driven=False,
            )
            for index, (limits, rest) in enumerate(_ARM)
        ),
        _finger("r_close", (0.0, 0.04)),
        _finger("l_close", (-0.03, 0.0)),
    ),
    ee_site=SAWYER_HAND,
    gripper_joints=SAWYER_FINGERS,
    gravity_compensated=False,
)
