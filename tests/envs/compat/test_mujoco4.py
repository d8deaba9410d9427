"""The repairs do what the packages meant, once."""

import mujoco
import numpy as np
import pytest

from envs.compat.mujoco4 import repair_metaworld, repair_robosuite

MODEL = """
<mujoco><worldbody><body name="a"><freejoint name="free"/><geom size=".1"/>
<body name="b" pos="1 0 0"><joint name="hinge"/><geom size=".1"/></body></body></worldbody></mujoco>
"""


@pytest.fixture
def binding_utils():
    module = pytest.importorskip("robosuite.utils.binding_utils")
    before = mujoco.mj_fullM
    repair_robosuite()
    yield module
    if before is not mujoco.mj_fullM:  # other tests see MuJoCo as it is
        mujoco.mj_fullM = before
        delattr(module, "_repaired_for_mujoco_4")


def test_meta_world_makes_its_welds():
    base = pytest.importorskip("metaworld.sawyer_xyz_env").SawyerMocapBase
    repair_metaworld()
    repaired = base.reset_mocap_welds
    repair_metaworld()
    assert base.reset_mocap_welds is repaired

    class Made:
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body name='m' mocap='true'/><body name='a'><freejoint/><geom size='.1'/>"
            "</body></worldbody><equality><connect body1='m' body2='a' anchor='1 2 3'/>"
            "<weld body1='m' body2='a'/></equality></mujoco>"
        )

    connect = Made.model.eq_data[0].copy()
    repaired(Made())
    np.testing.assert_array_equal(Made.model.eq_data[0], connect)
    np.testing.assert_array_equal(Made.model.eq_data[1][:11], [0, 0, 0, 0, 0, 0, -1, 0, 0, 0, 5])


@pytest.mark.slow
def test_robosuite_finds_its_joints(binding_utils):
    sim = binding_utils.MjSim(mujoco.MjModel.from_xml_string(MODEL))
    assert sim.model.get_joint_qpos_addr("free") == (0, 7)
    assert sim.model.get_joint_qpos_addr("hinge") == 7
    assert sim.model.get_joint_qvel_addr("free") == (0, 6)
    assert sim.model.get_joint_qvel_addr("hinge") == 6


def test_robosuite_gets_the_mass_matrix_in_its_own_order_and_ours_still_works(binding_utils):
    sim = binding_utils.MjSim(mujoco.MjModel.from_xml_string(MODEL))
    sim.forward()
    theirs, ours = np.zeros((7, 7)), np.zeros((7, 7))
    mujoco.mj_fullM(sim.model._model, theirs, sim.data.qM)
    mujoco.mj_fullM(sim.model._model, sim.data._data, ours)
    np.testing.assert_array_equal(theirs, ours)
    assert theirs[0, 0] == pytest.approx(sim.model.body_mass.sum())
    repaired = mujoco.mj_fullM
    repair_robosuite()
    assert mujoco.mj_fullM is repaired
