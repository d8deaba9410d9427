"""Contact exclusions: bodies that cannot touch, and that excluding them changes no motion."""

import mujoco
import numpy as np
import pytest

from envs.mjcf.contact_exclusions import pairs_never_in_contact
from envs.mjcf.model import build_models
from envs.tasks.pick_cube import PickCube

TWO_ARMS = """
<mujoco><worldbody>
  <body name="base"><geom type="box" size="0.1 0.1 0.1"/>
    <body name="near" pos="0 0 0.3">
      <joint name="turn" axis="0 0 1"/><geom type="box" size="0.05 0.05 0.1"/>
      <body name="far" pos="0 0 0.2">
        <joint name="bend" axis="0 1 0" limited="true" range="{range}"/>
        <geom type="capsule" fromto="0 0 0.1 0 0 0.4" size="0.02"/>
      </body>
    </body>
  </body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("limits", "apart"),
    [("-60 60", [("base", "near"), ("base", "far")]), ("-180 180", [("base", "near")])],
)
def test_limits_decide_what_cannot_touch(limits, apart):
    assert pairs_never_in_contact(mujoco.MjModel.from_xml_string(TWO_ARMS.format(range=limits))) == apart


@pytest.fixture(scope="module")
def models():
    scenario = PickCube().scenario
    return [build_models(scenario, prune=prune)[1] for prune in (False, True)]


def test_links_around_an_elbow_of_the_panda_cannot_touch(models):
    found = {(one.split("/")[-1], other.split("/")[-1]) for one, other in pairs_never_in_contact(models[0])}
    elbows = {("link1", "link3"), ("link2", "link4"), ("link3", "link5"), ("link4", "link6")}
    assert found >= {("link0", "link1"), ("link0", "link2"), *elbows}
    assert not found & {("link5", "link7"), ("link2", "link5"), ("leftfinger", "rightfinger")}
    assert models[1].nexclude == len(found) == 10


def test_nothing_moves_otherwise(models):
    rng = np.random.default_rng(0)
    targets = rng.uniform(*models[0].actuator_ctrlrange.T, (4, models[0].nu))
    ends = []
    for model in models:
        data = mujoco.MjData(model)
        for target in targets:
            data.ctrl[:] = target
            mujoco.mj_step(model, data, 100)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)
