"""Robots of robosuite and robosuite_models: to URDF and back, they keep what a controller needs."""

import importlib.util
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from envs.convert import convert

ROBOTS = {
    "spot": ("robosuite", "models/assets/robots/spot", (19, 18, 12)),
    "go2": ("robosuite_models", "assets/robots/go2", (19, 18, 12)),
    "kinova3": ("robosuite", "models/assets/robots/kinova3", (7, 7, 7)),
}
"""Name to package, folder, and how many positions, velocities and actuators it has."""

LOSSES = {
    "spot": ["Contact pairs and exclusions of bodies are left out.", "Sites (5) are left out."],
    "go2": ["Sites (6) are left out.", "Keyframes (1) are left out."],
    "kinova3": ["Sites (1) are left out."],
}

OF_ACTUATORS = ("gainprm", "biasprm", "dynprm", "gear", "ctrlrange", "forcerange", "ctrllimited")


def source_of(name):
    package, folder, _ = ROBOTS[name]
    # The file is found without an import of robosuite, which takes seconds and prints.
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        pytest.skip(f"{package} is not installed")
    return Path(found.origin).parent / folder / "robot.xml"


@pytest.fixture(scope="module", params=ROBOTS)
def there_and_back(request, tmp_path_factory):
    """Its name, its model, the model after the way through URDF, and the folder of the URDF file."""
    folder, source = tmp_path_factory.mktemp(request.param), source_of(request.param)
    urdf = convert(source, out=folder / "urdf")
    mjcf = convert(urdf, "mjcf", out=folder / "mjcf")
    before, after = (mujoco.MjModel.from_xml_path(str(path)) for path in (source, mjcf))
    return request.param, before, after, folder / "urdf"


def joints_of(model):
    """Each joint's kind, range, damping, friction and armature; a free base has no name in robosuite."""
    found = {}
    for index in range(model.njnt):
        dof = model.jnt_dofadr[index]
        values = (model.dof_damping[dof], model.dof_frictionloss[dof], model.dof_armature[dof])
        found[model.joint(index).name] = (model.jnt_type[index], *model.jnt_range[index], *values)
    return found


@pytest.mark.slow
def test_positions_velocities_and_actuators_are_as_many_as_before(there_and_back):
    name, before, after, _ = there_and_back
    assert (before.nq, before.nv, before.nu) == ROBOTS[name][2]
    assert (after.nq, after.nv, after.nu) == ROBOTS[name][2]
    assert after.body_mass.sum() == pytest.approx(before.body_mass.sum(), abs=1e-6)


@pytest.mark.slow
def test_a_base_that_floats_floats_again_and_one_that_is_bolted_down_does_not(there_and_back):
    name, before, after, _ = there_and_back
    free = [int(mujoco.mjtJoint.mjJNT_FREE) in model.jnt_type for model in (before, after)]
    assert free == [name != "kinova3"] * 2


@pytest.mark.slow
def test_joints_keep_range_damping_friction_and_armature(there_and_back):
    name, before, after, _ = there_and_back
    expected, found = joints_of(before), joints_of(after)
    assert set(found) == set(expected)
    for joint, values in expected.items():
        np.testing.assert_allclose(found[joint], values, atol=1e-6, err_msg=joint)
    # Of the three, Go2's file alone has armature: without it the comparison above would say nothing.
    assert (after.dof_armature.max() > 0.0) == (name == "go2")


@pytest.mark.slow
def test_actuators_drive_the_same_joints_in_the_same_way(there_and_back):
    _, before, after, _ = there_and_back
    for index in range(before.nu):
        drives = [model.joint(int(model.actuator_trnid[index, 0])).name for model in (before, after)]
        assert drives[0] == drives[1]
        for key in OF_ACTUATORS:
            values = [getattr(model, f"actuator_{key}")[index] for model in (before, after)]
            np.testing.assert_array_equal(*values, err_msg=f"{drives[0]}: {key}")


@pytest.mark.slow
def test_what_is_lost_is_named(there_and_back):
    name, before, after, folder = there_and_back
    assert json.loads((folder / "losses.json").read_text()) == LOSSES[name]
    lost = (before.nexclude - after.nexclude, before.nsite - after.nsite, before.nkey - after.nkey)
    assert lost == {"spot": (4, 5, 0), "go2": (0, 6, 1), "kinova3": (0, 1, 0)}[name]
