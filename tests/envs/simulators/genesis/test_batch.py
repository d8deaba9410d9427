"""Genesis's solver against MuJoCo itself: joints, bodies and shapes of one small world, built once."""

import mujoco
import numpy as np
import pytest

pytest.importorskip("genesis", reason="Genesis is not installed: see docs/simulator_costs.md")

from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import describe
from envs.simulators.genesis.batch import Batch
from envs.simulators.genesis.settings import GenesisSettings

pytestmark = pytest.mark.slow

OPTIONS = '<option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>'
"""Those of :class:`GenesisSettings`."""

JOINTS = {
    "plain": "",
    "armature": 'armature="1"',
    "damping": 'damping="2"',
    "spring": 'stiffness="100" damping="5" springref="20"',
    "friction": 'frictionloss="4"',
    "limit": 'range="-10 30" limited="true"',
    "ref": 'ref="30"',
    "driven": 'damping=".3"',
    "weak": 'damping=".3"',
}
SHAPES = {
    "box": (".05 .05 .05", 0.05),
    "cylinder": (".05 .04", 0.04),
    "sphere": (".05", 0.05),
    "ellipsoid": (".06 .05 .04", 0.04),
    "capsule": (".05 .1", 0.15),
}
PENDULUMS = "".join(
    f"""<body name="{name}" pos="{5 * index} 9 3"><joint name="{name}" axis="1 0 0" {joint}/>
    <inertial pos="0 .5 0" mass="1" diaginertia=".01 .02 .03"/></body>"""
    for index, (name, joint) in enumerate(JOINTS.items())
)
FALLING = "".join(
    f"""<body name="{shape}" pos="{5 * index} 0 {height + 0.01}"><freejoint name="{shape}"/>
    <geom type="{shape}" size="{size}" mass="1" friction=".8 .01 .0001" condim="4"/></body>"""
    for index, (shape, (size, height)) in enumerate(SHAPES.items())
)
WORLD = f"""<mujoco>{OPTIONS}
<asset><mesh name="wedge" vertex="0 0 0  .2 0 0  .2 .2 0  0 .2 0  0 0 .1  .2 0 .1"/></asset>
<worldbody><geom type="plane" size="0 0 .1" friction=".6 .005 .0001"/>{PENDULUMS}{FALLING}
<body name="chain" pos="0 -9 3"><joint name="x" type="slide" axis="1 0 0"/>
  <joint name="yaw" axis="0 0 1"/><inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body>
<body name="club" pos="5 -9 3"><freejoint name="club"/>
  <inertial pos=".3 0 .1" mass="2" diaginertia=".1 .2 .15"/></body>
<body name="trunk" pos="10 -9 3"><freejoint name="trunk"/>
  <inertial pos=".1 0 0" mass="3" diaginertia=".1 .2 .15"/>
  <body name="arm" pos="0 .2 0"><joint name="arm" axis="1 0 0"/>
    <inertial pos="0 .2 0" mass="1" diaginertia=".02 .02 .02"/></body></body>
<body name="thing" pos="0 5 .002"><freejoint name="thing"/><geom type="mesh" mesh="wedge" mass="1"/></body>
<body name="tray" mocap="true" pos="5 5 0"><geom type="box" size=".2 .2 .05"/></body>
<body name="ball" pos="5 5 .2"><freejoint name="ball"/><geom type="sphere" size=".05" mass=".1"/></body>
<body name="ghost" pos="10 5 .2"><freejoint name="ghost"/>
  <geom type="sphere" size=".05" mass=".1" contype="2" conaffinity="2"/></body>
</worldbody>
<actuator><position joint="driven" kp="200" kv="20"/>
  <position joint="weak" kp="200" kv="20" forcerange="-3 3"/></actuator></mujoco>"""

STEPS = 80


@pytest.fixture(scope="module")
def ends():
    """MuJoCo's data and Genesis's row (qpos, qvel) after the same start."""
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    rot = rng.normal(size=4)
    data.joint("club").qpos[3:] = rot / np.linalg.norm(rot)
    data.joint("club").qvel[:] = [0.4, -0.2, 0.1, 1.0, -2.0, 0.5]
    data.joint("trunk").qvel[:] = [0.3, -0.2, 0.1, 0.5, -0.4, 0.3]
    data.joint("arm").qvel[:], data.joint("yaw").qvel[:], data.joint("x").qvel[:] = 1.0, 2.0, 0.4
    data.mocap_pos[0] = [5.0, 5.0, 0.1]
    data.ctrl[:] = 0.5
    qpos, qvel, ctrl = (values.astype(np.float32) for values in (data.qpos, data.qvel, data.ctrl))
    data.qpos[:], data.qvel[:] = qpos, qvel
    batch = Batch(model, describe(model, "genesis"), GenesisSettings(), 2)
    try:
        for row in range(2):
            batch.place(row, data.mocap_pos, data.mocap_quat)
            batch.put(row, qpos, qvel, ctrl)
        both = np.stack([ctrl, ctrl])
        batch.step([0, 1], both, both, STEPS)
        batch.read(1, qpos, qvel)
    finally:
        batch.close()
    mujoco.mj_step(model, data, STEPS)
    return model, data, qpos, qvel


@pytest.mark.parametrize("name", [*JOINTS, "x", "yaw", "arm"])
def test_a_joint_moves_as_mujocos(ends, name):
    model, data, qpos, qvel = ends
    joint = model.joint(name)
    # Between the two joints of one body is a small mass.
    atol = 2e-3 if name in ("x", "yaw") else 2e-5
    np.testing.assert_allclose(qpos[joint.qposadr], data.joint(name).qpos, atol=atol)
    np.testing.assert_allclose(qvel[joint.dofadr], data.joint(name).qvel, atol=20 * atol)
    assert abs(data.joint(name).qpos[0] - model.qpos0[joint.qposadr[0]]) > 1e-4


@pytest.mark.parametrize(("name", "half_steps"), [("trunk", 0.0), ("ghost", 0.0), ("club", 1.0)])
def test_what_flies_moves_as_mujocos(ends, name, half_steps):
    """A lone body whose centre is not its origin falls half a step less, by the midpoint rule."""
    model, data, qpos, qvel = ends
    first, dof = int(model.joint(name).qposadr[0]), int(model.joint(name).dofadr[0])
    expected = data.joint(name).qpos.copy()
    expected[2] += half_steps * STEPS * 9.81 * 0.002**2 / 2
    slack = 1.0 if half_steps else 0.0
    np.testing.assert_allclose(qpos[first : first + 7], expected, atol=2e-5 + 3e-4 * slack)
    np.testing.assert_allclose(qvel[dof : dof + 6], data.joint(name).qvel, atol=4e-4 + 5e-3 * slack)


@pytest.mark.parametrize("name", [*SHAPES, "thing"])
def test_shape_falls_and_rests_as_in_mujoco(ends, name):
    model, data, qpos, _ = ends
    first = int(model.joint(name).qposadr[0])
    np.testing.assert_allclose(qpos[first : first + 3], data.joint(name).qpos[:3], atol=3e-3)


def test_mocap_body_carries_objects(ends):
    model, _, qpos, _ = ends
    assert qpos[int(model.joint("ball").qposadr[0]) + 2] == pytest.approx(0.2, abs=3e-3)


def test_what_genesis_cannot_do_is_refused_by_name():
    hills = """<mujoco><asset><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/></asset>
      <worldbody><geom name="land" type="hfield" hfield="hills"/></worldbody></mujoco>"""
    half = """<mujoco><worldbody><body name="kite" gravcomp="1"><freejoint/><geom size=".1" mass="1"/>
      <body name="tail"><joint/><geom size=".1" mass="1"/></body></body></worldbody></mujoco>"""
    for xml, message in (
        (hills, r"no collision shape for the geom 'land' \(mjGEOM_HFIELD\)"),
        (half, "takes gravity off all links of 'kite' or off none"),
        ("<mujoco/>", "nothing in this scene that Genesis could simulate"),
    ):
        model = mujoco.MjModel.from_xml_string(xml)
        with pytest.raises(SimulatorError, match=message):
            Batch(model, describe(model, "genesis"), GenesisSettings(), 1)
