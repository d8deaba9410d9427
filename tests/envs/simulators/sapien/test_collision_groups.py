"""Which shapes of SAPIEN touch, by hand-computed words and by what bodies do."""

import itertools
import logging

import mujoco
import numpy as np
import pytest

from envs.core.extras import install_command

pytest.importorskip("sapien", reason=f"SAPIEN is not installed: {install_command('sapien')}")

from envs.mjcf.collision import touching
from envs.mjcf.link_tree import describe
from envs.simulators.sapien.collision_groups import collision_groups
from envs.simulators.sapien.settings import SapienSettings
from envs.simulators.sapien.world import SapienWorld

IGNORED, ID = 2, 3


def balls(count, excluded):
    """Floating balls at one place, the geom of each with the number of its body less one."""
    bodies = "".join(f'<body name="b{index}"><freejoint/><geom size=".1"/></body>' for index in range(count))
    pairs = "".join(f'<exclude body1="b{one}" body2="b{other}"/>' for one, other in excluded)
    xml = f"<mujoco><worldbody>{bodies}</worldbody><contact>{pairs}</contact></mujoco>"
    return mujoco.MjModel.from_xml_string(xml)


def words_of(model):
    return collision_groups(model, describe(model, "sapien")).astype(np.int64)


def collide(words):
    """SAPIEN's rule, as its documentation of `set_collision_groups` has it."""
    one, other = words[:, None], words[None]
    matched = (one[..., 0] & other[..., 1]) | (one[..., 1] & other[..., 0])
    ignored = (one[..., IGNORED] & other[..., IGNORED]) * (one[..., ID] == other[..., ID])
    return (matched != 0) & (ignored == 0)


def touched(model):
    return touching(model, np.arange(model.ngeom))


def moved(xml, num_steps=50, **velocities):
    """Returns the positions of a model after steps in SAPIEN, and in MuJoCo."""
    model = mujoco.MjModel.from_xml_string(xml)
    spec, data = describe(model, "sapien"), mujoco.MjData(model)
    world = SapienWorld(model, spec, collision_groups(model, spec), SapienSettings())
    for joint, velocity in velocities.items():
        data.joint(joint).qvel = velocity
    qpos, qvel = data.qpos.astype(np.float32), data.qvel.astype(np.float32)
    world.put(qpos, qvel, np.zeros(0, np.float32))
    world.step(num_steps)
    world.read(qpos, qvel)
    mujoco.mj_step(model, data, num_steps)
    return qpos, data.qpos


def test_without_exclusions_no_shape_ignores_another():
    assert not words_of(balls(3, []))[:, (IGNORED, ID)].any()


def test_a_clique_of_ten_bodies_takes_one_bit(caplog):
    words = words_of(balls(10, itertools.combinations(range(10), 2)))  # 45 pairs
    assert words[:, IGNORED].tolist() == [1] * 10
    assert not caplog.text


def test_pairs_that_share_no_body_have_bits_of_their_own(caplog):
    """40 pairs of 80 bodies take one bit each, told apart by their ids."""
    words = words_of(balls(80, [(index, index + 1) for index in range(0, 80, 2)]))
    assert words[:, IGNORED].tolist() == [1] * 80
    assert words[:, ID].tolist() == np.repeat(np.arange(1, 41), 2).tolist()
    assert not caplog.text


def test_two_cliques_that_share_a_body_take_two_bits():
    words = words_of(balls(5, [(0, 1), (0, 2), (1, 2), (2, 3), (2, 4), (3, 4)]))
    assert sorted(words[:, IGNORED].tolist()) == [1, 1, 2, 2, 3]
    assert words[2, IGNORED] == 3


def test_thirty_two_pairs_in_a_row_are_all_kept_apart(caplog):
    model = balls(33, [(index, index + 1) for index in range(32)])
    np.testing.assert_array_equal(collide(words_of(model)) & ~np.eye(33, dtype=bool), touched(model))
    assert not caplog.text


def test_pairs_beyond_the_bits_are_reported(caplog):
    """39 pairs in a row form no larger clique, and there are 32 bits."""
    model = balls(40, [(index, index + 1) for index in range(39)])
    with caplog.at_level(logging.WARNING):
        words = words_of(model)
    wrong = collide(words) & ~touched(model) & ~np.eye(40, dtype=bool)
    assert wrong.sum() == 2 * 7
    first, second = np.argwhere(wrong)[0]
    assert "7 pairs of bodies collide in SAPIEN that the scene excludes from contact" in caplog.text
    assert f"such as 'b{first}' and 'b{second}'" in caplog.text
    assert "Take simulator=mujoco, or exclude fewer pairs" in caplog.text


def test_bodies_that_never_touch_share_the_bit_of_the_one_excluded_from_them(caplog):
    """A body and 40 others: 40 bits if those touch one another, and one if they do not."""
    model = balls(41, [(0, index) for index in range(1, 41)])
    model.geom_conaffinity[1:] = 2
    assert words_of(model)[:, IGNORED].tolist() == [1] * 41
    assert not caplog.text


@pytest.mark.parametrize("seed", range(4))
def test_random_exclusions_leave_the_pairs_that_touch_in_mujoco(seed, caplog):
    rng, share = np.random.default_rng(seed), (0.15, 0.4, 0.7, 0.9)[seed]
    pairs = [pair for pair in itertools.combinations(range(12), 2) if rng.random() < share]
    model = balls(12, pairs)
    assert not caplog.text
    np.testing.assert_array_equal(collide(words_of(model)) & ~np.eye(12, dtype=bool), touched(model))


OVERLAPPING = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="a"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="b" pos="0 0 .15"><freejoint/><geom type="box" size=".1 .1 .1"/></body></worldbody>
  <contact>{contact}</contact></mujoco>
"""


def test_excluded_bodies_of_two_trees_pass_through_each_other():
    kept, free = (moved(OVERLAPPING.format(contact=c))[0] for c in ("", '<exclude body1="a" body2="b"/>'))
    assert kept[9] - kept[2] > 0.17
    assert free[[2, 9]].tolist() == pytest.approx([0.0, 0.15])


def test_a_body_excluded_from_the_world_falls_through_the_floor():
    xml = """<mujoco><worldbody><geom type="box" size="2 2 .1" pos="0 0 -.1"/>
      <body name="a" pos="0 0 .1"><freejoint/><geom size=".1"/></body></worldbody>
      <contact><exclude body1="world" body2="a"/></contact></mujoco>"""
    ours, mujocos = moved(xml, 100)
    assert ours[2] == pytest.approx(mujocos[2], abs=0.01)
    assert ours[2] < 0.0


JOINTED = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="trunk"><freejoint/><geom type="box" size=".1 .1 .1" mass="5"/>
    <body name="arm" pos="0 0 .15">{joints}
      <geom type="box" size=".1 .1 .1" mass="1"/></body></body></worldbody>
</mujoco>
"""


@pytest.mark.parametrize("second", ["", '<joint name="y" axis="0 1 0"/>'])
def test_a_body_never_touches_its_parent_however_many_joints_are_between_them(second):
    """PhysX keeps a link from its parent alone, and each joint of a body has a link."""
    ours, mujocos = moved(JOINTED.format(joints='<joint name="x" axis="1 0 0"/>' + second), x=1.0)
    np.testing.assert_allclose(ours, mujocos, atol=2e-3)


PAIRED = """
<mujoco><worldbody>
  <body name="a"><freejoint/><geom name="a" size=".1" {bits}/></body>
  <body name="b"><freejoint/><geom name="b" size=".1"/><geom size=".1"/></body>
  <body name="c"><freejoint/><geom size=".1"/></body></worldbody>
  <contact><pair geom1="a" geom2="b"/>{exclude}</contact></mujoco>
"""


@pytest.mark.parametrize(
    ("bits", "exclude"), [('contype="0" conaffinity="0"', ""), ("", '<exclude body1="a" body2="b"/>')]
)
def test_a_pair_of_geoms_touches_whatever_else_its_bodies_do_not(bits, exclude):
    model = mujoco.MjModel.from_xml_string(PAIRED.format(bits=bits, exclude=exclude))
    found = collide(words_of(model))
    assert found[0, 1]
    assert not found[0, 2]
    assert found[0, 3] == bool(exclude)
    assert found[1, 3]
