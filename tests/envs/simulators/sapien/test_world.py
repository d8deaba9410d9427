"""PhysX against closed forms, on small models."""

import mujoco
import numpy as np
import pytest

from envs.core.extras import install_command

pytest.importorskip("sapien", reason=f"SAPIEN is not installed: {install_command('sapien')}")

from envs.mjcf.link_tree import describe
from envs.simulators.sapien.collision_groups import collision_groups
from envs.simulators.sapien.settings import SapienSettings
from envs.simulators.sapien.world import SapienWorld

DT = 0.002
PENDULUM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="bob"><joint name="j" axis="1 0 0" {joint}/>
      <inertial pos="0 .5 0" mass="1" diaginertia=".01 .01 .01"/></body>
  </worldbody>
  {actuator}
</mujoco>
"""
INERTIA, TORQUE = 0.26, -9.81 * 0.5
"""About the axis, kg·m², and of gravity on the level bob, N·m."""


class Bench:
    """A world of a small model, and its row."""

    def __init__(self, xml):
        self.model = mujoco.MjModel.from_xml_string(xml)
        spec = describe(self.model, "sapien")
        groups = collision_groups(self.model, spec)
        self.world = SapienWorld(self.model, spec, groups, SapienSettings())
        self.qpos, self.qvel = self.model.qpos0.astype(np.float32), np.zeros(self.model.nv, np.float32)
        self.ctrl = np.zeros(self.model.nu, np.float32)

    def put(self):
        self.world.put(self.qpos, self.qvel, self.ctrl)

    def run(self, num_steps):
        self.world.step(num_steps)
        self.world.read(self.qpos, self.qvel)


def pendulum(joint="", actuator=""):
    bench = Bench(PENDULUM.format(joint=joint, actuator=actuator))
    bench.put()
    return bench


@pytest.mark.parametrize(("joint", "inertia"), [("", INERTIA), ('armature="1"', INERTIA + 1.0)])
def test_a_pendulum_falls_with_its_inertia_and_armature(joint, inertia):
    bench = pendulum(joint)
    bench.run(50)
    angle = speed = 0.0
    for _ in range(50):
        speed += TORQUE * np.cos(angle) / inertia * DT
        angle += speed * DT
    assert bench.qvel[0] == pytest.approx(speed, rel=1e-4)
    assert bench.qpos[0] == pytest.approx(angle, rel=1e-4)


def test_a_spring_rests_where_it_balances_gravity():
    bench = pendulum('stiffness="100" damping="50" springref="0"')
    bench.run(3000)
    assert bench.qpos[0] == pytest.approx(TORQUE / 100, rel=2e-3)


def test_dry_friction_holds_below_its_limit_and_yields_above():
    held, slipping = pendulum('frictionloss="6"'), pendulum('frictionloss="4"')
    held.run(500)
    slipping.run(50)
    assert abs(held.qpos[0]) < 2e-3
    assert slipping.qvel[0] == pytest.approx((TORQUE + 4.0) / INERTIA * 0.1, rel=0.05)


def test_dry_friction_leaves_damping_and_springs_in_place():
    free, damped = pendulum('frictionloss="1"'), pendulum('frictionloss="1" damping="2"')
    for bench in (free, damped):
        bench.run(50)
    assert abs(damped.qvel[0]) < 0.9 * abs(free.qvel[0])


def test_a_driven_joint_pushes_no_harder_than_its_limit():
    drive = '<actuator><position joint="j" kp="1000" kv="50" forcerange="-3 3"/></actuator>'
    bench = pendulum("", drive)
    bench.ctrl[:] = 1.0
    bench.world.drive(bench.ctrl)
    bench.run(50)
    assert bench.qvel[0] == pytest.approx((TORQUE + 3.0) / INERTIA * 0.1, rel=0.03)


def test_a_driven_joint_rubs():
    drive = '<actuator><position joint="j" kp="0" kv="0"/></actuator>'
    smooth, rough = pendulum("", drive), pendulum('frictionloss="2"', drive)
    for bench in (smooth, rough):
        bench.run(50)
    assert rough.qvel[0] == pytest.approx(smooth.qvel[0] * (1 - 2.0 / abs(TORQUE)), rel=0.1)


LOPSIDED = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="club"><freejoint/>
    <inertial pos=".3 0 .1" mass="2" diaginertia=".1 .2 .15"/></body></worldbody>
</mujoco>
"""


def test_velocities_of_a_lopsided_body_are_its_origins_and_its_own_frames():
    """Set and read back through the centre of mass; then a step moves the body as MuJoCo moves it."""
    bench = Bench(LOPSIDED)
    rng = np.random.default_rng(1)
    rot = rng.normal(size=4)
    bench.qpos[:] = [1, 2, 3, *(rot / np.linalg.norm(rot))]
    bench.qvel[:] = [0.4, -0.2, 0.1, 1.0, -2.0, 0.5]
    data = mujoco.MjData(bench.model)
    data.qpos[:], data.qvel[:] = bench.qpos, bench.qvel
    bench.put()
    bench.run(10)
    for _ in range(10):
        mujoco.mj_step(bench.model, data)
    np.testing.assert_allclose(bench.qpos, data.qpos, atol=2e-4)
    np.testing.assert_allclose(bench.qvel, data.qvel, atol=2e-2)


FREE_ARM = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="trunk" pos="0 0 1"><freejoint/>
    <inertial pos=".1 0 0" mass="3" diaginertia=".1 .2 .15"/>
    <body name="arm" pos="0 .2 0"><joint name="j" axis="1 0 0"/>
      <inertial pos="0 .2 0" mass="1" diaginertia=".02 .02 .02"/></body></body></worldbody>
</mujoco>
"""


def test_a_tree_that_floats_moves_as_mujocos():
    bench = Bench(FREE_ARM)
    bench.qvel[:] = [0.3, -0.2, 0.1, 0.5, -0.4, 0.3, 1.0]
    data = mujoco.MjData(bench.model)
    data.qvel[:] = bench.qvel
    bench.put()
    bench.run(20)
    for _ in range(20):
        mujoco.mj_step(bench.model, data)
    np.testing.assert_allclose(bench.qpos, data.qpos, atol=1e-3)
    np.testing.assert_allclose(bench.qvel, data.qvel, atol=0.03)


SLOPE = """
<mujoco><option timestep="0.002" gravity="{gravity}"/>
  <worldbody><geom type="box" size="2 2 .1" pos="0 0 -.1" friction="{mu} .005 .0001"/>
    <body name="{name}" pos="0 0 {height}"><freejoint/>
      <geom type="{shape}" size="{size}" mass="1" friction="{mu} .005 .0001"/></body></worldbody>
</mujoco>
"""


def resting(shape, size, height):
    return SLOPE.format(gravity="0 0 -9.81", mu=1, shape=shape, size=size, height=height, name="thing")


SHAPES = {
    "box": (".05 .05 .05", 0.05),
    "cylinder": (".05 .04", 0.04),
    "sphere": (".05", 0.05),
    "ellipsoid": (".06 .05 .04", 0.04),
    "capsule": (".05 .1", 0.15),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_rest_at_their_height(shape):
    size, height = SHAPES[shape]
    bench = Bench(resting(shape, size, height))
    bench.put()
    bench.run(100)
    assert bench.qpos[2] == pytest.approx(height, abs=2e-3)


@pytest.mark.parametrize(("mu", "slides"), [(0.4, True), (0.7, False)])
def test_a_box_slides_where_the_slope_is_steeper_than_friction(mu, slides):
    """Gravity leans by atan 0.5."""
    lean = "4.387 0 -8.774"
    bench = Bench(SLOPE.format(gravity=lean, mu=mu, shape="box", size=".05 .05 .05", height=0.05, name="box"))
    bench.put()
    bench.run(250)
    expected = 0.5 * (4.387 - mu * 8.774) * 0.5**2 if slides else 0.0
    assert bench.qpos[0] == pytest.approx(expected, rel=0.1, abs=0.01)


def test_what_is_put_forgets_the_contacts_before():
    bench = Bench(resting("box", ".05 .05 .05", 0.1))
    tilted = np.array([0, 0, 0.08, 0.9, 0.3, 0.2, 0.1], np.float32)
    tilted[3:] /= np.linalg.norm(tilted[3:])
    ends = []
    for _ in range(2):
        bench.qpos[:], bench.qvel[:] = tilted, 0.0
        bench.put()
        bench.run(120)
        ends.append(bench.qpos.copy())
        bench.qpos[:3] = 0.0, 0.3, 0.04
        bench.put()
        bench.run(13)
    np.testing.assert_array_equal(*ends)


FREE_SERVO = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="trunk" pos="0 0 1"><freejoint/>
    <inertial pos=".1 0 0" mass="30" diaginertia="1 2 1.5"/>
    <body name="arm" pos="0 .2 0"><joint name="j" axis="1 0 0" damping="2" armature=".1"/>
      <inertial pos="0 .2 0" mass="1" diaginertia=".02 .02 .02"/></body></body></worldbody>
  <actuator><position joint="j" kp="100" kv="5" forcerange="-6 6"/></actuator>
</mujoco>
"""


def test_the_damping_of_a_driven_joint_acts_beside_the_actuators_limit():
    """What gives all its force is slowed down to limit / damping, 3 rad/s, by a joint's own damping."""
    bench = Bench(FREE_SERVO)
    data = mujoco.MjData(bench.model)
    bench.put()
    bench.ctrl[:] = data.ctrl[:] = 2.0
    bench.world.drive(bench.ctrl)
    for num_steps in (50, 70, 380):  # at full force, still so, and arrived
        bench.run(num_steps)
        for _ in range(num_steps):
            mujoco.mj_step(bench.model, data)
        assert bench.qpos[7] == pytest.approx(data.qpos[7], abs=3.0 * DT)
        assert bench.qvel[6] == pytest.approx(data.qvel[6], rel=0.02, abs=0.01)
    np.testing.assert_allclose(bench.qpos[:7], data.qpos[:7], atol=2e-3)
