import gzip
import json
import pickle

import numpy as np
import pytest

from envs.core.errors import DatasetError
from envs.rotations import from_yaw, multiply
from envs.tasks import TASKS
from roboverse_learn.data.importers import roboverse
from roboverse_learn.data.importers.retarget import ARMS, tool_path
from roboverse_learn.data.importers.roboverse import RoboVerseFile
from tests.roboverse_learn.data.importers.recordings import arrays, roboverse_episode

TASK = TASKS.get("PickCube")(variant="lift")
SAWYER_START = {
    **{f"right_j{i}": q for i, q in enumerate((0.0, -0.8, 0.0, 1.4, 0.0, 1.0, 1.57))},
    **{"right_gripper_l_finger_joint": 0.0206, "right_gripper_r_finger_joint": -0.0206, "head_pan": 0.0},
}


def written(path, content):
    """Writes a file in the format of its suffix."""
    data = json.dumps(content).encode() if ".json" in path.name else pickle.dumps(content, 4)
    path.write_bytes(gzip.compress(data) if path.name.endswith(".gz") else data)
    return path


@pytest.fixture
def content(lifted):
    return {"franka": [roboverse_episode(one) for one in lifted]}


@pytest.mark.parametrize("name", ["a.json", "a.json.gz", "a.pkl", "a.pkl.gz"])
def test_every_kind_of_file_gives_the_same(tmp_path, content, lifted, name):
    opened = RoboVerseFile(written(tmp_path / name, content), TASK)
    assert opened.names == ("franka_0", "franka_1")
    for index, one in enumerate(lifted):
        demonstration, raw = opened.read(f"franka_{index}"), arrays(one)
        assert demonstration.succeeded is None and demonstration.first_state == 0
        np.testing.assert_allclose(demonstration.targets, one.actions, atol=1e-6)
        robot, cube = demonstration.states.robots["franka"], demonstration.states.objects["cube"]
        np.testing.assert_allclose(robot.joint_pos, raw["franka/joint_pos"], atol=1e-9)
        np.testing.assert_allclose(cube.pos, raw["cube/pos"], atol=1e-9)
        # It has no velocities: they are what the positions say.
        np.testing.assert_allclose(robot.joint_vel[1:], np.diff(raw["franka/joint_pos"], axis=0) * 20)
        assert abs(cube.lin_vel.numpy() - raw["cube/lin_vel"]).mean() < 0.05


def test_arrays_in_place_of_lists_are_read_too(tmp_path, content):
    for frame in content["franka"][0]["states"]:
        frame["cube"]["pos"] = np.array(frame["cube"]["pos"], np.float32)
    opened = RoboVerseFile(written(tmp_path / "a.pkl.gz", content), TASK)
    assert opened.read("franka_0").has_states


def test_the_scene_moves_with_the_robots_base(tmp_path, content):
    """In the file the robot's base has another pose; relative to the base nothing has changed."""
    plain = RoboVerseFile(written(tmp_path / "a.json", content), TASK).read("franka_0").states.objects["cube"]
    turn = from_yaw(0.3)
    for frame in [content["franka"][0]["init_state"], *content["franka"][0]["states"]]:
        for entity in frame.values():
            x, y, z = entity["pos"]
            entity["pos"] = [x * np.cos(0.3) - y * np.sin(0.3) + 1, x * np.sin(0.3) + y * np.cos(0.3) - 2, z]
            entity["rot"] = multiply(turn, np.array(entity["rot"])).tolist()
    moved = RoboVerseFile(written(tmp_path / "b.json", content), TASK).read("franka_0").states.objects["cube"]
    np.testing.assert_allclose(moved.pos, plain.pos, atol=1e-9)
    np.testing.assert_allclose(moved.lin_vel, plain.lin_vel, atol=1e-6)
    np.testing.assert_allclose((moved.rot * plain.rot).sum(-1).abs(), 1.0, atol=1e-9)


def test_a_replay_by_states_begins_after_the_jump_from_the_reset(tmp_path, content):
    content["franka"][0]["init_state"]["franka"]["dof_pos"]["panda_joint1"] = 1.0
    demonstration = RoboVerseFile(written(tmp_path / "a.json", content), TASK).read("franka_0")
    assert demonstration.first_state == 1
    assert not demonstration.states.robots["franka"].joint_vel[:2].any()


def test_targets_that_go_on_after_the_last_state_are_left_out(tmp_path, content, lifted):
    actions = content["franka"][0]["actions"]
    actions += actions[-1:] * 40
    demonstration = RoboVerseFile(written(tmp_path / "a.json", content), TASK).read("franka_0")
    assert len(demonstration.targets) == len(lifted[0].actions) == demonstration.states.num_envs - 1


@pytest.mark.slow
def test_a_sawyer_is_followed_by_its_tool(tmp_path, content):
    moved = [{**SAWYER_START, "right_j0": 0.02 * step} for step in range(6)]
    moved[-1]["right_gripper_l_finger_joint"], moved[-1]["right_gripper_r_finger_joint"] = 0.0026, -0.0026
    start = content["franka"][0]["init_state"]
    robot = {**start.pop("franka"), "dof_pos": moved[0]}
    episode = {
        "init_state": {**start, "sawyer": robot},
        "actions": [{"dof_pos_target": joints} for joints in moved[1:]],
        "states": None,
    }
    file = written(tmp_path / "a.json", {"sawyer": [episode]})
    demonstration = RoboVerseFile(file, TASK).read("sawyer_0")
    assert not demonstration.has_states
    assert demonstration.facts["targets"] == "retargeted" and demonstration.facts["max_error_m"] < 1e-3
    np.testing.assert_allclose(demonstration.targets[:, 7:], [[0.04, 0.04]] * 4 + [[0.0, 0.0]], atol=1e-6)
    # Both tools are at the same distance from the bases' axes, and turn about them alike.
    path = tool_path(ARMS["sawyer"], {name: np.array([m[name] for m in moved]) for name in moved[0]})
    yaw = np.arctan2(path.pos[:, 1], path.pos[:, 0])
    np.testing.assert_allclose(np.diff(yaw), 0.02, atol=1e-6)
    del episode["actions"][2]["dof_pos_target"]["right_j3"]
    again = RoboVerseFile(written(tmp_path / "b.json", {"sawyer": [episode]}), TASK)
    with pytest.raises(DatasetError, match=r"incomplete or damaged \(KeyError: 'right_j3'\)"):
        again.read("sawyer_0")


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda e: e.pop("init_state"), r"'franka_0' of '.*' is incomplete or damaged \("),
        (lambda e: e.update(init_state=None), r"'franka_0' of '.*' is incomplete or damaged \("),
        (lambda e: e["actions"][3].pop("dof_pos_target"), r"'franka_0' of '.*' is incomplete or damaged \("),
        (lambda e: e["actions"].clear(), "The robot's joints has the shape"),
        (lambda e: e["states"][3]["cube"].update(pos=[0.0, 1.0]), "Positions of 'cube' is not an array"),
        (lambda e: e["states"][3]["cube"].update(pos=["x", 0, 0]), "Positions of 'cube' is not an array"),
        (lambda e: e["states"][3]["cube"].update(pos=[float("nan"), 0, 0]), "'cube' is not finite at 4"),
        (lambda e: e["states"][3]["franka"]["dof_pos"].pop("panda_joint3"), "incomplete.*panda_joint3"),
        (lambda e: e.update(states=7), r"'franka_0' of '.*' is incomplete or damaged \("),
        (lambda e: e["init_state"]["cube"].update(rot=[0, 0, 0, 0]), "not a unit quaternion"),
    ],
)
def test_a_damaged_episode_spoils_no_other(tmp_path, content, damage, says):
    damage(content["franka"][0])
    opened = RoboVerseFile(written(tmp_path / "a.json", content), TASK)
    assert opened.read("franka_1").has_states
    with pytest.raises(DatasetError, match=says):
        opened.read("franka_0")


@pytest.mark.parametrize("name", ["a.json", "a.json.gz", "a.pkl", "a.pkl.gz"])
def test_a_truncated_file_is_named(tmp_path, content, name):
    file = written(tmp_path / name, content)
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(DatasetError, match=f"'{file}' .*Download it again"):
        RoboVerseFile(file, TASK)


@pytest.mark.parametrize(
    ("content_of", "says"),
    [
        ([], "holds a list; RoboVerse's files hold a dict"),
        ({}, "it holds nothing"),
        ({"iiwa": []}, "one robot of franka, sawyer; it holds iiwa"),
        ({"franka": [], "sawyer": []}, "it holds franka, sawyer"),
        (
            {"franka": [{"init_state": {"franka": {}, "box_base": {}}}]},
            "it moves box_base; the task needs cube",
        ),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, content_of, says):
    with pytest.raises(DatasetError, match=says):
        RoboVerseFile(written(tmp_path / "a.json", content_of), TASK)


def test_a_bomb_is_not_unpacked(tmp_path, content, monkeypatch):
    monkeypatch.setattr(roboverse, "MAX_BYTES", 1 << 20)
    file = tmp_path / "a.json.gz"
    file.write_bytes(gzip.compress(b"0" * (2 << 20)))
    with pytest.raises(DatasetError, match="unpacks to more than 1 MiB"):
        RoboVerseFile(file, TASK)
    file.write_bytes(gzip.compress(b"[" * 100_000))
    with pytest.raises(DatasetError, match="is not JSON"):
        RoboVerseFile(file, TASK)


def test_a_malicious_file_is_refused(tmp_path):
    class Evil:
        def __reduce__(self):
            return exec, (f"open({str(tmp_path / 'made')!r}, 'w')",)

    file = written(tmp_path / "a.pkl.gz", {"franka": [{"init_state": Evil()}]})
    with pytest.raises(DatasetError, match=r"a\.pkl\.gz' was not read .*it names 'builtins\.exec'"):
        RoboVerseFile(file, TASK)
    assert not (tmp_path / "made").exists()


@pytest.mark.slow
def test_another_robot_of_ours_follows_the_files_arm(tmp_path, content, lifted):
    """Its base may stand elsewhere; the hand and the objects are where they are for the task's own robot."""
    import torch

    from envs.kinematics.forward import KinematicChain
    from envs.spec import EnvSpec

    spec = EnvSpec(task="PickCube", task_kwargs={"variant": "lift"}, robot="kinova3")
    task, own = spec.make_task(), spec.replace(robot="").make_task()
    assert task.robot.pos != own.robot.pos
    file = written(tmp_path / "a.json", content)
    theirs = RoboVerseFile(file, own).read("franka_0")
    ours = RoboVerseFile(file, task).read("franka_0")
    assert ours.facts["targets"] == "retargeted" and ours.facts["max_error_m"] < 1e-3
    np.testing.assert_allclose(ours.states.objects["cube"].pos, theirs.states.objects["cube"].pos)
    hands = []
    for demonstration, robot in ((ours, task.robot), (theirs, own.robot)):
        chain = KinematicChain(robot)
        hands.append(chain(torch.from_numpy(demonstration.targets[:, chain.columns].astype(float))).pos)
        np.testing.assert_allclose(demonstration.states.robots[robot.name].pos[0], robot.pos)
    np.testing.assert_allclose(*hands, atol=2e-3)
    np.testing.assert_allclose(ours.targets[:, list(task.robot.fingers)], theirs.targets[:, 7:], atol=1e-6)
