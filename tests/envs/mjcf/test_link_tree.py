"""A compiled model as rigid links; nothing here needs another simulator."""

import mujoco
import numpy as np
import pytest

from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import compose, describe, inverse
from envs.mjcf.model import build_model
from envs.rotations import from_euler, to_matrix
from envs.tasks.close_box import CloseBox
from envs.tasks.pick_cube import PickCube

ARM = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 1">
      <geom name="foot" type="box" size=".1 .1 .1" mass="5"/>
      <body name="upper" pos="0 0 .2" euler="0 0 30">
        <joint name="turn" axis="0 1 0" pos="0 0 .05" range="-90 90" damping=".3" armature=".2"
               frictionloss=".4" stiffness="2" springref="20" ref="10"/>
        <geom name="bar" type="capsule" size=".02 .2" mass="1"/>
        <body name="tip" pos=".1 0 .3" euler="40 0 0">
          <geom name="ball" type="sphere" size=".05" mass="2" contype="0" conaffinity="0"/>
        </body>
        <body name="hand" pos="0 0 .5">
          <joint name="x" type="slide" axis="1 0 0"/>
          <joint name="yaw" axis="0 0 1"/>
          <geom name="palm" type="box" size=".03 .03 .03" mass=".5"/>
        </body>
      </body>
    </body>
    <body name="cart">
      <joint name="rail" type="slide" axis="0 1 0"/>
      <geom name="body" type="box" size=".1 .1 .1" mass="1"/>
    </body>
    <body name="stone" pos="1 0 .5"><freejoint/><geom name="rock" type="sphere" size=".1" mass="3"/></body>
    <body name="shelf" mocap="true" pos="2 0 0"><geom name="board" type="box" size=".1 .1 .1"/></body>
    <body name="post" pos="3 0 0"><geom name="pole" type="cylinder" size=".1 .5"/></body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="100" kv="7" forcerange="-9 9"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(ARM)


@pytest.fixture(scope="module")
def scene(model):
    return describe(model, "sapien")


def tree(scene, name):
    return next(tree for tree in scene.trees if any(link.name == name for link in tree.links))


def names(model, geoms):
    return [model.geom(geom).name for geom, _ in geoms]


def test_what_no_joint_carries_is_part_of_the_world(model, scene):
    assert names(model, scene.still) == ["floor", "pole"]
    np.testing.assert_allclose(scene.still[1][1][0], (3, 0, 0))


def test_roots_are_free_put_in_place_or_bolted(model, scene):
    assert {tree.links[-1].name: tree.root for tree in scene.trees} == {
        "hand": "fixed",
        "cart": "fixed",
        "stone": "free",
        "shelf": "mocap",
    }
    assert tree(scene, "stone").qpos == model.jnt_qposadr[model.body("stone").jntadr[0]]
    assert tree(scene, "shelf").mocap == 0


def test_bodies_that_no_joint_parts_are_one_link_with_their_common_inertia(model, scene):
    """Mass, centre and moments by hand, about the common centre."""
    link = next(link for link in tree(scene, "upper").links if link.name == "upper")
    assert names(model, link.geoms) == ["bar"]
    assert link.inertia is not None
    assert link.inertia.mass == pytest.approx(3.0)
    np.testing.assert_allclose(link.inertia.frame[0], np.array([0.1, 0.0, 0.3]) * 2 / 3, atol=1e-12)
    bar, ball = model.body("upper").inertia, model.body("tip").inertia
    away = [np.zeros(3) - link.inertia.frame[0], np.array([0.1, 0, 0.3]) - link.inertia.frame[0]]
    total = np.diag(bar) + np.diag(ball)
    for mass, arm in zip((1.0, 2.0), away, strict=True):
        total += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    turn = to_matrix(link.inertia.frame[1])
    np.testing.assert_allclose(turn @ np.diag(link.inertia.moments) @ turn.T, total, atol=1e-9)


def test_a_joint_carries_over_what_the_model_says_of_it(model, scene):
    joint = next(link for link in tree(scene, "upper").links if link.name == "upper").joint
    assert joint is not None
    assert (joint.kind, joint.kp, joint.kd, joint.force_limit) == ("hinge", 100.0, 7.0, 9.0)
    assert (joint.damping, joint.armature, joint.friction, joint.stiffness) == (0.3, 0.2, 0.4, 2.0)
    assert joint.rest == pytest.approx(np.deg2rad(20))
    assert joint.limits == pytest.approx((-np.pi / 2, np.pi / 2))


def test_a_body_with_two_joints_is_a_chain(scene):
    links = tree(scene, "hand").links
    assert [link.name for link in links] == ["base", "upper", "x", "hand"]
    assert [link.joint.kind if link.joint else None for link in links] == [None, "hinge", "slide", "hinge"]
    assert links[2].inertia.mass < 0.01
    assert not links[2].geoms


def test_a_joint_against_the_world_gets_a_root_that_never_moves(scene):
    links = tree(scene, "cart").links
    assert [(link.name, link.parent, link.inertia is None) for link in links] == [
        ("world", -1, True),
        ("cart", 0, False),
    ]


@pytest.mark.parametrize("make", [lambda: mujoco.MjModel.from_xml_string(ARM), *(
    (lambda task=task: build_model(task().scenario)) for task in (PickCube, CloseBox)
)])  # fmt: skip
def test_forward_kinematics_agrees_with_mujoco(make):
    """Links placed by their joints alone are where MuJoCo has them, in random postures."""
    model = make()
    scene, data, rng = describe(model, "sapien"), mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(5):
        data.qpos[:] = model.qpos0
        for joint in range(model.njnt):
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
                data.qpos[model.jnt_qposadr[joint]] = rng.uniform(-1, 1)
        mujoco.mj_kinematics(model, data)
        for spec in scene.trees:
            frames = []
            for link in spec.links:
                if link.joint is None:
                    frames.append(spec.pose)
                    continue
                q = data.qpos[link.joint.qpos]
                hinge = link.joint.kind == "hinge"
                moved = np.zeros(3) if hinge else np.array([q, 0.0, 0.0])
                turned = from_euler(np.array([0.0, 0.0, q if hinge else 0.0]))
                at = compose(compose(frames[link.parent], link.joint.in_parent), (moved, turned))
                frames.append(compose(at, inverse(link.joint.in_child)))
                if link.inertia is not None and link.inertia.mass > 0.01:
                    np.testing.assert_allclose(frames[-1][0], data.xpos[link.body], atol=1e-9)
                    np.testing.assert_allclose(
                        to_matrix(frames[-1][1]), data.xmat[link.body].reshape(3, 3), atol=1e-9
                    )


def test_an_equality_is_refused_by_name():
    xml = """<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body>
      <body name="b"><freejoint/><geom size=".1"/></body></worldbody>
      <equality><weld body1="a" body2="b"/></equality></mujoco>"""
    with pytest.raises(SimulatorError, match=r"simulator=newton has no equality constraint .* 'a' and 'b'"):
        describe(mujoco.MjModel.from_xml_string(xml), "newton")


def test_the_robots_mass_is_all_there():
    model = build_model(PickCube().scenario)
    spec = next(spec for spec in describe(model, "sapien").trees if len(spec.links) > 1)
    ours = sum(link.inertia.mass for link in spec.links if link.inertia is not None)
    root = model.body("franka/base").id
    assert ours == pytest.approx(model.body_subtreemass[root], rel=1e-9)
    assert all(link.weightless for link in spec.links)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ('<body><joint name="hip" type="ball"/><geom size=".1"/></body>', r"no ball joint such as 'hip'"),
        (None, r"The actuator 'push' does not drive a joint to a position"),
    ],
)
def test_what_only_mujoco_has_is_refused_by_name(part, message):
    slide = '<body><joint name="s" type="slide"/><geom size=".1"/></body>'
    motor = '<actuator><motor name="push" joint="s"/></actuator>'
    xml = f"<mujoco><worldbody>{part or slide}</worldbody>{'' if part else motor}</mujoco>"
    with pytest.raises(SimulatorError, match=message):
        describe(mujoco.MjModel.from_xml_string(xml), "newton")
