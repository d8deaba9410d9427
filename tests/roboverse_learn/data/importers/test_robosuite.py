import json

import h5py
import numpy as np
import pytest

from envs.core.errors import DatasetError
from envs.kinematics.forward import KinematicChain
from envs.spec import EnvSpec
from envs.tasks import TASKS
from roboverse_learn.data.importers.robosuite import RobosuiteFile
from tests.roboverse_learn.data.importers.recordings import ROBOSUITE_XML, arrays, write_robosuite

TASK = TASKS.get("PickCube")(variant="lift")


@pytest.fixture
def file(tmp_path, lifted):
    return write_robosuite(tmp_path / "lift.hdf5", lifted)


def test_a_panda_whose_base_is_where_ours_is_keeps_its_joints(file, lifted):
    opened = RobosuiteFile(file, TASK)
    assert opened.names == ("demo_1", "demo_2")
    for name, one in zip(opened.names, lifted, strict=True):
        demonstration, raw = opened.read(name), arrays(one)
        assert (
            demonstration.facts["targets"] == "from states" and "cube of 40" in demonstration.facts["differs"]
        )
        robot, cube = demonstration.states.robots["franka"], demonstration.states.objects["cube"]
        np.testing.assert_allclose(robot.joint_pos, raw["franka/joint_pos"], atol=1e-12)
        for field in ("pos", "rot", "lin_vel", "ang_vel"):
            np.testing.assert_allclose(getattr(cube, field), raw[f"cube/{field}"], atol=1e-12, err_msg=field)
        shut = one.actions[:, 7] < 0.02
        fingers = np.where(shut, 0.0, 0.04)[:, None] * [1, 1]
        np.testing.assert_array_equal(demonstration.targets[:, 7:], fingers)
    opened.close()


def test_a_panda_on_a_pedestal_is_followed_by_its_hand(tmp_path, lifted, lift_env):
    file = write_robosuite(tmp_path / "lift.hdf5", lifted[:1], base_z=0.913)
    demonstration = RobosuiteFile(file, TASK).read("demo_1")
    assert demonstration.facts["targets"] == "retargeted" and demonstration.facts["max_error_m"] < 1e-3
    moments = np.arange(0, demonstration.states.num_envs, 10)
    recorded = arrays(lifted[0])["franka/ee_pos"][moments] + [0, 0, 0.113]
    for moment, expected in zip(moments, recorded, strict=True):
        lift_env.handler.set_states(demonstration.states.select([moment]), [0])
        reached = lift_env.get_states([0]).robots["franka"].ee_pos[0]
        np.testing.assert_allclose(reached, expected, atol=1.5e-3)
    fingers = demonstration.states.robots["franka"].joint_pos[:, 7]
    np.testing.assert_allclose(fingers, arrays(lifted[0])["franka/joint_pos"][:, 7:].mean(1), atol=1e-3)


@pytest.mark.parametrize("where", ["models/model_1.xml", "model_1.xml", "lift_model_1.xml"])
def test_the_model_may_be_a_file(file, where):
    place = file.parent / where
    place.parent.mkdir(exist_ok=True)
    place.write_text(ROBOSUITE_XML.format(base_z=0.8))
    with h5py.File(file, "r+") as content:
        content["data/demo_1"].attrs["model_file"] = "model_1.xml"
    assert RobosuiteFile(file, TASK).read("demo_1").has_states


def set_model(text):
    return lambda demo: demo.attrs.__setitem__("model_file", text)


def slower(demo):
    demo["states"][:, 0] = np.arange(len(demo["states"])) / 10.0


def fewer_actions(demo):
    del demo["actions"]
    demo["actions"] = [[0.0]]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (set_model("model_7.xml"), "Its model 'model_7.xml' is neither"),
        (set_model("<mujoco><body></mujoco>"), "incomplete or damaged"),
        (set_model("<mujoco/>"), r"states has the shape .*; \(any, 1\) is needed"),
        (set_model(ROBOSUITE_XML.format(base_z=0.8).replace("table_top", "top")), "incomplete or damaged"),
        (lambda demo: demo.attrs.pop("model_file"), "incomplete or damaged"),
        (lambda demo: demo.pop("states"), "incomplete or damaged"),
        (lambda demo: demo["states"].__setitem__((3, 5), np.nan), "states is not finite at 3"),
        (fewer_actions, "states and 1 actions"),
        (slower, "recorded at 10.0 Hz; the task runs at 20 Hz"),
    ],
)
def test_a_damaged_episode_spoils_no_other(file, damage, says):
    with h5py.File(file, "r+") as content:
        damage(content["data/demo_1"])
    opened = RobosuiteFile(file, TASK)
    with pytest.raises(DatasetError, match=says):
        opened.read("demo_1")
    assert opened.read("demo_2").has_states


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"env": "Juggle"}, "'Juggle', and no registered task is the same"),
        ({"env": "Stack"}, "Give task=StackCube"),
        ({"env": ""}, "does not say which environment"),
        ({"env_info": "{"}, "does not say which environment"),
        (
            {"env_info": json.dumps({"robots": ["Panda", "Sawyer"]})},
            "moves 2 robots; in PickCube there are 1",
        ),
    ],
)
def test_a_file_of_something_else_is_refused(file, attributes, says):
    with h5py.File(file, "r+") as content:
        content["data"].attrs.update(attributes)
    with pytest.raises(DatasetError, match=says):
        RobosuiteFile(file, TASK)


def test_a_newer_file_names_its_environment_elsewhere(file):
    with h5py.File(file, "r+") as content:
        del content["data"].attrs["env"], content["data"].attrs["env_info"]
        described = {"env_name": "Lift", "env_kwargs": {"robots": ["Panda"]}}
        content["data"].attrs["env_args"] = json.dumps(described)
    assert RobosuiteFile(file, TASK).read("demo_1").facts["robot"] == "Panda"


def test_a_truncated_or_empty_file_is_named(file):
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DatasetError, match=r"lift\.hdf5' is not a complete HDF5 file"):
        RobosuiteFile(file, TASK)
    with h5py.File(file, "w") as content:
        content["other"] = 1
    with pytest.raises(DatasetError, match=r"lift\.hdf5' holds no demonstrations of robosuite"):
        RobosuiteFile(file, TASK)


@pytest.mark.slow
def test_another_robot_of_ours_follows_the_hand_in_the_same_scene(file):
    """Its base may stand elsewhere than that of the task's own, for which the scene was made."""
    spec = EnvSpec(task="PickCube", task_kwargs={"variant": "lift"}, robot="kinova3")
    task = spec.make_task()
    assert task.robot.pos != TASK.robot.pos
    own, other = RobosuiteFile(file, TASK), RobosuiteFile(file, task)
    theirs, ours = own.read("demo_1"), other.read("demo_1")
    assert ours.facts["targets"] == "retargeted" and ours.facts["max_error_m"] < 2e-3
    np.testing.assert_allclose(ours.states.objects["cube"].pos, theirs.states.objects["cube"].pos, atol=1e-9)
    hands = []
    for demonstration, robot in ((ours, task.robot), (theirs, TASK.robot)):
        chain = KinematicChain(robot)
        hands.append(chain(demonstration.states.robots[robot.name].joint_pos[:, chain.columns]).pos)
    np.testing.assert_allclose(*hands, atol=2e-3)
    own.close()
    other.close()
