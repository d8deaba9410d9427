"""The Robotiq 2F-85 opens, closes and holds as its data sheet says, and any arm takes it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from envs.core.errors import SimulatorError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.robots import ARMS, GRIPPERS, ROBOTS, with_grippers
from envs.robots.franka import FRANKA
from envs.robots.panda_hand import PANDA_HAND
from envs.robots.robotiq_2f85 import ROBOTIQ_2F85
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
from envs.simulators import HANDLERS
from envs.tasks.make import make_task
from envs.tasks.tabletop import CONTROL_20_HZ

ROBOT = ROBOTS.get("ur5e_2f85")
LEADER = ROBOT.fingers[0]


class Hand:
    """The gripper on its arm, and perhaps a cube between the fingertips."""

    def __init__(self, cube_m=None):
        cube = [] if cube_m is None else [self._cube(cube_m)]
        scene = ScenarioCfg(
            robots=(ROBOT,), objects=tuple(cube), table=None, room=None, physics=CONTROL_20_HZ
        )
        self.model = build_model(scene)
        self.model.opt.gravity[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self.layout = layout_of(self.model, scene).robots[0]
        self.data.qpos[self.layout.qpos] = ROBOT.default_qpos
        rest = np.array([joint.default for joint in ROBOT.joints])
        self.data.ctrl[self.layout.ctrl] = rest[list(ROBOT.driven)]
        mujoco.mj_forward(self.model, self.data)
        self.tips = [geom for geom in range(self.model.ngeom) if self.model.geom_contype[geom] == 2]
        if cube:
            first = int(self.model.jnt_qposadr[self.model.body("cube").jntadr[0]])
            site, turn = self.data.site(self.layout.ee_site), np.empty(4)
            mujoco.mju_mat2Quat(turn, site.xmat)
            behind = 0.01 * site.xmat.reshape(3, 3)[:, 2]
            self.data.qpos[first : first + 7] = [*(site.xpos - behind), *turn]

    @staticmethod
    def _cube(edge_m):
        return ObjectCfg(name="cube", geoms=(GeomCfg(shape="box", size=(edge_m / 2,) * 3, mass_kg=0.1),))

    def close(self, seconds, target=0.8):
        self.data.ctrl[self.layout.ctrl[list(ROBOT.driven).index(LEADER)]] = target
        mujoco.mj_step(self.model, self.data, round(seconds / self.model.opt.timestep))

    @property
    def gap_m(self):
        mujoco.mj_kinematics(self.model, self.data)
        return mujoco.mj_geomDistance(self.model, self.data, *self.tips, 1.0, None)

    @property
    def joints(self):
        return self.data.qpos[self.layout.qpos]


def test_it_opens_to_85_mm_and_closes_at_150_mm_per_second():
    hand = Hand()
    assert hand.gap_m == pytest.approx(ROBOT.opening_m, abs=0.001)
    hand.close(0.2)
    before = hand.gap_m
    hand.close(0.1)
    assert (before - hand.gap_m) / 0.1 == pytest.approx(0.150, rel=0.05)
    hand.close(1.0)
    assert 0.0 <= hand.gap_m < 0.0015
    assert ROBOT.finger_positions(0.0).tolist() == [0.8] and ROBOT.finger_positions(0.5).tolist() == [0.0]


def test_the_loops_stay_closed_and_the_fingertips_parallel():
    hand = Hand()
    for target in (0.3, 0.8, 0.0):
        hand.close(1.0, target)
        for index, joint in enumerate(ROBOT.joints):
            if joint.follows is not None:
                assert hand.joints[index] == pytest.approx(joint.follows[1] * hand.joints[LEADER], abs=1e-3)
        turns = [hand.data.geom_xmat[tip].reshape(3, 3)[:, 2] for tip in hand.tips]
        assert turns[0] @ turns[1] == pytest.approx(1.0, abs=1e-4)


def test_it_presses_a_cube_with_what_the_motor_gives():
    hand = Hand(cube_m=0.04)
    hand.close(1.0)
    assert hand.gap_m == pytest.approx(0.04, abs=0.001)
    presses = []
    for tip in hand.tips:
        force, total = np.zeros(6), 0.0
        for index, pair in enumerate(hand.data.contact.geom):
            if tip in pair:
                mujoco.mj_contactForce(hand.model, hand.data, index, force)
                total += force[0]
        presses.append(total)
    assert presses == pytest.approx([46.0, 46.0], rel=0.1)
    assert 20.0 <= min(presses) <= max(presses) <= 235.0, "the data sheet's range"
    for index, joint in enumerate(ROBOT.joints):  # the grip does not bend the ties
        if joint.follows is not None:
            assert hand.joints[index] == pytest.approx(joint.follows[1] * hand.joints[LEADER], abs=0.005)


def test_every_arm_takes_every_gripper():
    for arm, (own, *_) in ARMS.items():
        for gripper in GRIPPERS:
            robot = ROBOTS.get(f"{arm}_{gripper}")
            assert robot.name == f"{arm}_{gripper}" and robot.arm == ROBOTS.get(own).arm
            assert robot.gripper_joints == GRIPPERS.get(gripper).gripper_joints
            assert GRIPPERS.entry(gripper).summary in ROBOTS.entry(robot.name).summary
    with pytest.raises(AttributeError, match="no attribute 'UR5E_TONGS'"):
        _ = with_grippers.UR5E_TONGS


def test_a_gripper_is_exchanged_for_another_and_back():
    changed = FRANKA.with_gripper(ROBOTIQ_2F85, "franka_2f85")
    assert changed.opening_m == 0.085 and changed.finger_limits == ((0.8, 0.0),)
    assert changed.with_gripper(PANDA_HAND, "franka") == FRANKA


def test_joints_that_follow_are_where_they_must_be_at_rest():
    half = ROBOT.with_home([*ROBOT.default_qpos[:LEADER], 0.4, *[0.0] * 5])
    assert half.default_qpos[LEADER:] == (0.4, -0.4, 0.4, 0.4, -0.4, 0.4)
    task = make_task("PickChocolatePudding", robot="ur5e_2f85")  # begins with fingers that are half open
    fingers = np.array(task.robot.default_qpos[LEADER:])
    assert 0.1 < fingers[0] < 0.7
    np.testing.assert_allclose(fingers, fingers[0] * np.array([1, -1, 1, 1, -1, 1]))


@pytest.mark.parametrize("simulator", ["pybullet", "sapien", "newton"])
def test_a_simulator_without_ties_refuses_it(simulator):
    pytest.importorskip(simulator)
    scene = ScenarioCfg(robots=(replace(ROBOT, name="hand"),), table=None, physics=CONTROL_20_HZ)
    handler = HANDLERS.get(simulator)(scene, 1)
    with pytest.raises(SimulatorError, match=r"has no equality constraint such as.*Take simulator=mujoco"):
        handler.launch()
