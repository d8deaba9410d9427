"""Newton's solver against MuJoCo itself on small models, step by step."""

import mujoco
import numpy as np
import pytest

from envs.core.extras import install_command

pytest.importorskip("newton", reason=f"Newton is not installed: {install_command('newton')}")

from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import describe
from envs.simulators.newton import shapes
from envs.simulators.newton.scene import build
from envs.simulators.newton.settings import NewtonSettings
from envs.simulators.newton.shapes import touching
from envs.simulators.newton.world import NewtonWorld

OPTIONS = '<option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>'
"""Those of :class:`NewtonSettings`."""


class Bench:
    """A world of a small model, its row, and MuJoCo beside it."""

    def __init__(self, body, rest=""):
        xml = f"<mujoco>{OPTIONS}<worldbody>{body}</worldbody>{rest}</mujoco>"
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.world = NewtonWorld(
            self.model, build(self.model, describe(self.model, "newton")), NewtonSettings()
        )
        self.data = mujoco.MjData(self.model)
        self.qpos, self.qvel = self.model.qpos0.astype(np.float32), np.zeros(self.model.nv, np.float32)
        self.ctrl = np.zeros(self.model.nu, np.float32)
        self.mocap = (self.data.mocap_pos.copy(), self.data.mocap_quat.copy())

    def run(self, num_steps):
        """Puts the row into both and runs both."""
        self.world.place(*self.mocap)
        self.world.put(self.qpos, self.qvel, self.ctrl)
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[:] = self.qpos, self.qvel, self.ctrl
        self.data.mocap_pos[:], self.data.mocap_quat[:] = self.mocap
        self.data.qacc_warmstart[:] = 0.0
        self.world.step(num_steps)
        for _ in range(num_steps):
            mujoco.mj_step(self.model, self.data)
        self.world.read(self.qpos, self.qvel)

    def check(self, atol):
        np.testing.assert_allclose(self.qpos, self.data.qpos, atol=atol)
        np.testing.assert_allclose(self.qvel, self.data.qvel, atol=20 * atol)


def pendulum(joint="", actuator=""):
    drive = f'<actuator><position joint="j" {actuator}/></actuator>' if actuator else ""
    return Bench(
        f"""<body name="bob"><joint name="j" axis="1 0 0" {joint}/>
        <inertial pos="0 .5 0" mass="1" diaginertia=".01 .02 .03"/></body>""",
        drive,
    )


@pytest.mark.parametrize(
    "joint",
    [
        "",
        'armature="1"',
        'damping="2"',
        'stiffness="100" damping="5" springref="20"',
        'frictionloss="4"',
        'frictionloss="6"',
        'range="-10 30" limited="true"',
        'ref="30"',
    ],
)
def test_a_pendulum_swings_as_mujocos(joint):
    bench = pendulum(joint)
    bench.run(60)
    bench.check(2e-5)
    assert np.abs(bench.data.qpos).max() > 1e-4


@pytest.mark.parametrize("limit", ["", 'forcerange="-3 3"'])
def test_a_driven_joint_has_the_same_gains_and_limit(limit):
    bench = pendulum('damping=".3"', f'kp="200" kv="20" {limit}')
    bench.ctrl[:] = 0.5
    bench.run(80)
    bench.check(2e-5)
    assert abs(bench.qpos[0]) > 0.05


def test_a_slide_and_a_chain_of_two_joints_of_one_body():
    bench = Bench(
        """<body name="base" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/>
        <joint name="yaw" axis="0 0 1"/><geom type="box" size=".1 .2 .05" mass="2"/></body>"""
    )
    bench.qvel[:] = [0.4, 2.0]
    bench.run(50)
    # Between the two joints is a small mass.
    bench.check(2e-3)
    np.testing.assert_allclose(bench.qpos, [0.04, 0.2], atol=2e-3)


def test_velocities_of_a_lopsided_body_are_its_origins_and_its_own_frames():
    bench = Bench(
        """<body name="club"><freejoint/>
        <inertial pos=".3 0 .1" mass="2" diaginertia=".1 .2 .15"/></body>"""
    )
    rot = np.random.default_rng(1).normal(size=4)
    bench.qpos[:] = [1, 2, 3, *(rot / np.linalg.norm(rot))]
    bench.qvel[:] = [0.4, -0.2, 0.1, 1.0, -2.0, 0.5]
    bench.run(30)
    bench.check(2e-5)


def test_a_tree_that_floats_moves_as_mujocos():
    bench = Bench(
        """<body name="trunk" pos="0 0 1"><freejoint/>
        <inertial pos=".1 0 0" mass="3" diaginertia=".1 .2 .15"/>
        <body name="arm" pos="0 .2 0"><joint name="j" axis="1 0 0"/>
          <inertial pos="0 .2 0" mass="1" diaginertia=".02 .02 .02"/></body></body>"""
    )
    bench.qvel[:] = [0.3, -0.2, 0.1, 0.5, -0.4, 0.3, 1.0]
    bench.run(40)
    bench.check(2e-5)


SHAPES = {
    "box": (".05 .05 .05", 0.05),
    "cylinder": (".05 .04", 0.04),
    "sphere": (".05", 0.05),
    "ellipsoid": (".06 .05 .04", 0.04),
    "capsule": (".05 .1", 0.15),
}


@pytest.mark.parametrize("floor", ['type="plane" size="2 2 .1"', 'type="box" size="2 2 .1" pos="0 0 -.1"'])
@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_fall_and_lie_as_mujocos(shape, floor):
    size, height = SHAPES[shape]
    bench = Bench(
        f"""<geom {floor} friction=".6 .005 .0001"/>
        <body name="thing" pos="0 0 {height + 0.01}"><freejoint/>
          <geom type="{shape}" size="{size}" mass="1" friction=".8 .01 .0001" condim="4"
                solref=".01 1" solimp=".95 .99 .001"/></body>"""
    )
    bench.qvel[0] = 0.1
    bench.run(100)
    bench.check(5e-4)
    assert bench.qpos[2] == pytest.approx(height, abs=3e-3)


def test_mesh_rests_on_its_hull():
    bench = Bench(
        """<geom type="plane" size="2 2 .1"/><body name="thing" pos="0 0 .06"><freejoint/>
          <geom type="mesh" mesh="wedge" mass="1"/></body>""",
        '<asset><mesh name="wedge" vertex="0 0 0  .2 0 0  .2 .2 0  0 .2 0  0 0 .1  .2 0 .1"/></asset>',
    )
    bench.run(100)
    bench.check(5e-4)


def test_mocap_body_carries_objects():
    bench = Bench(
        """<body name="tray" mocap="true" pos="1 0 0"><geom type="box" size=".2 .2 .05"/></body>
        <body name="ball" pos="0 0 .2"><freejoint/><geom type="sphere" size=".05" mass=".1"/></body>"""
    )
    bench.mocap[0][0] = [0.0, 0.0, 0.1]
    bench.run(150)
    assert bench.qpos[2] == pytest.approx(0.2, abs=3e-3)


def test_what_is_put_forgets_the_contacts_before():
    bench = Bench(
        """<geom type="box" size="2 2 .1" pos="0 0 -.1"/>
        <body name="thing"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>"""
    )
    tilted = np.array([0, 0, 0.08, 0.9, 0.3, 0.2, 0.1], np.float32)
    tilted[3:] /= np.linalg.norm(tilted[3:])
    ends = []
    for _ in range(2):
        bench.qpos[:], bench.qvel[:] = tilted, 0.0
        bench.run(120)
        ends.append(bench.qpos.copy())
        bench.qpos[:3] = 0.0, 0.3, 0.04
        bench.run(13)
    np.testing.assert_array_equal(*ends)


WHO_TOUCHES_WHOM = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 1"/>
  <body name="base"><geom name="foot" size=".1"/>
    <body name="upper"><joint axis="0 1 0"/><geom name="bar" size=".1"/>
      <body name="lower"><joint axis="0 1 0"/><geom name="palm" size=".1"/>
        <geom name="nail" size=".1" contype="0"/></body></body></body>
  <body name="stone"><freejoint/><geom name="rock" size=".1"/></body>
  <body name="leaf"><freejoint/><geom name="blade" size=".1" contype="0" conaffinity="1"/></body>
  <body name="ghost"><freejoint/><geom name="mist" size=".1" contype="0" conaffinity="0"/></body>
</worldbody>
<contact><exclude body1="stone" body2="lower"/><pair geom1="mist" geom2="rock"/></contact></mujoco>
"""


def test_who_touches_whom_is_what_mujoco_says():
    model = mujoco.MjModel.from_xml_string(WHO_TOUCHES_WHOM)
    names = [model.geom(index).name for index in range(model.ngeom)]
    table = touching(model, np.arange(model.ngeom))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # all spheres are in one place
    found = {frozenset(names[geom] for geom in pair) for pair in data.contact.geom}
    expected = {
        frozenset((names[i], names[j])) for i, j in np.argwhere(table) if i < j and (i or names[j] != "foot")
    }
    assert expected == found


def crowd(count):
    """Pebbles that all touch but for each with its neighbour."""
    bodies = "".join(
        f'<body name="p{i}" pos="{i} 0 0"><freejoint/><geom name="g{i}" size=".1"/></body>'
        for i in range(count)
    )
    rest = "".join(f'<exclude body1="p{i}" body2="p{i + 1}"/>' for i in range(0, count - 1, 2))
    return Bench(bodies, f"<contact>{rest}</contact>")


def test_pairs_that_newton_confuses_are_refused(monkeypatch):
    crowd(6)
    original = shapes.touching
    monkeypatch.setattr(
        shapes, "touching", lambda model, geoms: original(model, geoms) & bool(model.geom(0).name == "g0")
    )
    with pytest.raises(SimulatorError, match=r"which of this scene's 6 shapes touch, as 'g0' and 'g2'"):
        crowd(6)


def test_a_shape_that_newton_does_not_get_is_refused_by_name():
    xml = """<mujoco><asset><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/></asset>
      <worldbody><geom name="land" type="hfield" hfield="hills"/></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    with pytest.raises(SimulatorError, match=r"no collision shape for the geom 'land' \(mjGEOM_HFIELD\)"):
        build(model, describe(model, "newton"))
