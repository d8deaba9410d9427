"""Recordings of robosuite's own environments, made here by random actions, of each task that imports."""

import importlib
import json
import shutil
import warnings
import xml.etree.ElementTree as ElementTree

import h5py
import mujoco
import numpy as np
import pytest
import torch

from envs.compat.mujoco4 import repair_robosuite
from envs.core.errors import DatasetError
from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.robosuite.wipe import MARKERS
from roboverse_learn.data.importers.replayer import Replayer
from roboverse_learn.data.importers.robosuite import RobosuiteFile
from tests.sweeps import sweep

pytestmark = pytest.mark.slow

STEPS = 12
BODIES = {
    "ToolHang": {"stand": "stand_root", "frame": "frame_root", "tool": "tool_root"},
    "Door": {"door": "Door_main"},
    "Wipe": {"dirt_00": "contact0_main", "dirt_99": "contact99_main"},
    "TwoArmLift": {"pot": "pot_root"},
    "TwoArmHandover": {"hammer": "hammer_root"},
    "TwoArmPegInHole": {},
    "TwoArmTransport": {
        "payload": "payload_root",
        "trash": "trash_main",
        "lid": "transport_start_bin_lid_root",
        "target_walls": "transport_target_bin_root",
    },
    "PickPlaceCan": {"can": "Can_main"},
    "NutAssemblySquare": {"square_nut": "SquareNut_main"},
    "Stack": {"cube_a": "cubeA_main", "cube_b": "cubeB_main"},
}
"""Environments, and our objects with robosuite 1.5's bodies."""

TABLE_M = {"TwoArmPegInHole": 0.0, "Wipe": 0.9, "PickPlaceCan": 0.78, "NutAssemblySquare": 0.82}


def made(name):
    """robosuite's environment, started, without a renderer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # robosuite's escapes and absent optional parts
        suite = importlib.import_module("robosuite")
        repair_robosuite()
        robots = ["Panda", "Panda"] if name.startswith("TwoArm") else "Panda"
        env = suite.make(
            name, robots=robots, has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False
        )
        env.reset()
    return env


@pytest.fixture(scope="module", params=sweep(BODIES, {"ToolHang", "Door", "TwoArmLift", "Wipe"}))
def recorded(request, tmp_path_factory):
    """Name, file of one demonstration, and where its bodies and hands were at each moment."""
    name, path = request.param, tmp_path_factory.mktemp("robosuite") / "demo.hdf5"
    np.random.seed(1)  # robosuite draws starts with the global generator
    env, rng = made(name), np.random.default_rng(0)
    states, actions, bodies, joints = [], [], {ours: [] for ours in BODIES[name]}, []
    mujoco.mj_saveLastXML(str(path.with_suffix(".xml")), env.sim.model._model)  # as robosuite's get_xml
    for _ in range(STEPS):
        states.append(env.sim.get_state().flatten())
        for ours, theirs in BODIES[name].items():
            bodies[ours].append(env.sim.data.get_body_xpos(theirs).copy())
        joints.append([env.sim.data.qpos[robot._ref_joint_pos_indexes].copy() for robot in env.robots])
        actions.append(rng.uniform(-1.0, 1.0, env.action_dim))
        env.step(actions[-1])
    env.close()
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env"] = name
        data.attrs["env_info"] = json.dumps({"robots": ["Panda"] * len(env.robots)})
        demo = data.create_group("demo_1")
        demo.attrs["model_file"] = path.with_suffix(".xml").read_text()
        demo["states"], demo["actions"] = np.array(states), np.array(actions)
    return name, path, {ours: np.array(pos) for ours, pos in bodies.items()}, joints


def test_bodies_and_joints_are_where_robosuite_had_them(recorded):
    name, path, bodies, joints = recorded
    task = TASKS.get(name)()
    opened = RobosuiteFile(path, task)
    demonstration = opened.read("demo_1")
    opened.close()
    assert demonstration.facts["targets"] == "from states"
    for ours, pos in bodies.items():
        found = demonstration.states.objects[ours].pos.numpy()
        assert np.abs(found - pos + [0.0, 0.0, TABLE_M.get(name, 0.8)]).max() < 2e-3, ours
    for index, robot in enumerate(task.robots):
        found = demonstration.states.robots[robot.name].joint_pos.numpy()
        np.testing.assert_allclose(found[:, :7], [moment[index] for moment in joints], atol=1e-9)


def test_it_replays_by_states_and_by_controls(recorded):
    """Random actions solve nothing; a failed replay is one that was possible."""
    name, path, _, _ = recorded
    opened = RobosuiteFile(path, TASKS.get(name)())
    demonstration = opened.read("demo_1")
    opened.close()
    env = EnvSpec(task=name).make(1, split="train", observation="state")
    try:
        for by in ("states", "controls"):
            (episode,) = Replayer(env).replay([demonstration], [0], by, record=("states",))
            assert not episode.success and episode.length >= STEPS - 1
    finally:
        env.close()


def changed(path, folder, name, change):
    """Reads a copy of a recording that was changed."""
    copy = folder / "copy.hdf5"
    shutil.copy(path, copy)
    with h5py.File(copy, "r+") as file:
        change(file["data"])
    task = TASKS.get(name)()
    opened = RobosuiteFile(copy, task)
    try:
        return task, opened.read("demo_1")
    finally:
        opened.close()


@pytest.mark.parametrize("recorded", ["Door"], indirect=True)
@pytest.mark.parametrize(("angle", "solved"), [(0.31, True), (0.29, False)])
def test_a_door_that_was_opened_is_a_success(recorded, tmp_path, angle, solved):
    def turn(data):
        data["demo_1/states"][-1, 1 + 9] = angle  # time, arm and fingers are before it

    task, demonstration = changed(recorded[1], tmp_path, "Door", turn)
    assert task.success(demonstration.states).tolist() == [False] * (STEPS - 1) + [solved]


@pytest.mark.parametrize("recorded", ["Door"], indirect=True)
def test_a_door_with_a_latch_is_not_the_one_without(recorded):
    with pytest.raises(DatasetError, match="Its door has the joint 'Door_latch_joint'"):
        RobosuiteFile(recorded[1], TASKS.get("Door")(latch=False)).read("demo_1")


@pytest.mark.parametrize("recorded", ["TwoArmLift"], indirect=True)
@pytest.mark.parametrize(("up_m", "solved"), [(0.2, True), (0.0, False)])
def test_a_pot_that_was_lifted_is_a_success(recorded, tmp_path, up_m, solved):
    def lift(data):
        data["demo_1/states"][-1, 1 + 18 + 2] += up_m  # time, both arms, and the pot's x and y are before it

    task, demonstration = changed(recorded[1], tmp_path, "TwoArmLift", lift)
    assert task.success(demonstration.states).tolist() == [False] * (STEPS - 1) + [solved]


@pytest.mark.parametrize("recorded", ["TwoArmLift"], indirect=True)
@pytest.mark.parametrize(
    ("robots", "says"),
    [
        (["Panda"], "moves 1 robots; in TwoArmLift there are 2"),
        (["Panda", "Sawyer"], "Its robot 1 is a Sawyer"),
    ],
)
def test_robots_of_another_number_or_kind_are_refused(recorded, tmp_path, robots, says):
    with pytest.raises(DatasetError, match=says):
        changed(
            recorded[1],
            tmp_path,
            "TwoArmLift",
            lambda data: data.attrs.__setitem__("env_info", json.dumps({"robots": robots})),
        )


@pytest.mark.parametrize("recorded", ["Wipe"], indirect=True)
def test_what_was_wiped_off_follows_from_how_the_arm_moved(recorded, tmp_path):
    """Our expert's episode as robosuite records one: markers in the model, joints in the states."""
    env = EnvSpec(task="Wipe").make(1, split="train", observation="state")
    try:
        (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=("states",))
        states = episode.states
        assert episode.success and states is not None
        joints = states.robots["franka_wiper"].joint_pos.numpy().astype(np.float64)

        def record(data):
            demo, model = data["demo_1"], ElementTree.fromstring(data["demo_1"].attrs["model_file"])
            table = next(body for body in model.iter("body") if body.get("name") == "table")
            middle = np.array(table.get("pos").split(), float)[:2]
            bodies = {body.get("name"): body for body in table.iter("body")}
            for index, name in enumerate(MARKERS):
                x, y = states.objects[name].pos[0, :2].numpy() - middle
                body = bodies[f"contact{index}_main"]
                body.set("pos", f"{x:.9f} {y:.9f} {body.get('pos').split()[2]}")
            demo.attrs["model_file"] = ElementTree.tostring(model, encoding="unicode")
            rows = np.zeros((len(joints), demo["states"].shape[1]))
            rows[:, 0], rows[:, 1:8] = 0.05 * np.arange(len(joints)), joints
            del demo["states"], demo["actions"]
            demo["states"], demo["actions"] = rows, np.zeros((len(rows), 6))

        task, demonstration = changed(recorded[1], tmp_path, "Wipe", record)
        left = task.left(demonstration.states)
        assert left[0].all() and not left[-1].any()
        assert (left[1:] <= left[:-1]).all()  # none comes back
        assert torch.equal(left, task.left(states))
        (replayed,) = Replayer(env).replay([demonstration], [0], "states", record=())
        assert replayed.success
    finally:
        env.close()


@pytest.mark.parametrize("recorded", ["Wipe"], indirect=True)
def test_another_number_of_markers_is_refused(recorded, tmp_path):
    def rename(data):
        text = data["demo_1"].attrs["model_file"]
        data["demo_1"].attrs["model_file"] = text.replace("contact99_main", "contact_99")

    with pytest.raises(DatasetError, match=r"99 markers of dirt as robosuite 1\.5 names them; Wipe has 100"):
        changed(recorded[1], tmp_path, "Wipe", rename)
