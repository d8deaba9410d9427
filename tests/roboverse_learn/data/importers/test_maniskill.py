import json
from dataclasses import asdict

import h5py
import numpy as np
import pytest

from envs.core.errors import DatasetError
from envs.rotations import from_euler, multiply, rotate
from envs.spec import EnvSpec
from envs.tasks import TASKS
from roboverse_learn.config.compose import compose
from roboverse_learn.data.importers.maniskill import SCENES, ManiSkillFile
from roboverse_learn.data.importers.maniskill_sizes import drawn_sizes, peg_sizes
from tests.roboverse_learn.data.importers.recordings import arrays, write_maniskill

TASK = TASKS.get("PickCube")()


@pytest.fixture
def file(tmp_path, played):
    return write_maniskill(tmp_path / "two", played)


def test_states_and_targets_are_those_of_the_recording(file, played):
    opened = ManiSkillFile(file, TASK)
    assert opened.names == ("traj_0", "traj_1")
    for name, one in zip(opened.names, played, strict=True):
        demonstration = opened.read(name)
        raw = arrays(one)
        assert demonstration.has_states and demonstration.succeeded is True
        assert demonstration.facts == {"control_mode": "pd_joint_pos", "targets": "recorded"}
        np.testing.assert_allclose(demonstration.targets, one.actions, atol=1e-6)
        states = demonstration.states.flatten()
        for ours, theirs in (("robots/franka", "franka"), ("objects/cube", "cube"), ("objects/goal", "goal")):
            for field in ("pos", "rot", "lin_vel", "ang_vel", "joint_pos", "joint_vel"):
                expected = raw[f"{theirs}/{field}"]
                np.testing.assert_allclose(states[f"{ours}/{field}"], expected, atol=1e-6, err_msg=field)
    opened.close()


def test_the_gripper_of_minus_one_to_one_is_minus_one_to_four_centimetres(file):
    with h5py.File(file, "r+") as content:
        content["traj_0/actions"][:3, 7] = [-1.0, 0.0, 1.0]
    targets = ManiSkillFile(file, TASK).read("traj_0").targets
    np.testing.assert_allclose(targets[:3, 7:], [[0.0, 0.0], [0.015, 0.015], [0.04, 0.04]], atol=1e-9)


def test_other_control_modes_follow_the_recorded_positions(file):
    beside = file.with_suffix(".json")
    info = json.loads(beside.read_text())
    info["episodes"][1]["control_mode"] = "pd_ee_delta_pose"
    beside.write_text(json.dumps(info))
    opened = ManiSkillFile(file, TASK)
    demonstration = opened.read("traj_1")
    assert demonstration.facts["targets"] == "from states"
    moved = np.diff(demonstration.states.robots["franka"].joint_pos.numpy()[:, :7], axis=0)
    led = demonstration.targets[:, :7] - demonstration.states.robots["franka"].joint_pos.numpy()[:-1, :7]
    np.testing.assert_allclose(led, moved / (1 - np.exp(-0.5)), atol=1e-9)  # a lag of 0.1 s, steps of 0.05 s


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda group: group["env_states/actors/cube"].__setitem__(3, np.nan), "'cube' is not finite at 3"),
        (
            lambda group: group["env_states"]["actors"].pop("cube"),
            r"'traj_0' of '.*' is incomplete or damaged \(",
        ),
        (lambda group: group.pop("actions"), r"'traj_0' of '.*' is incomplete or damaged \("),
        (lambda group: group.pop("env_states"), r"It has no env_states\. Record with RecordEpisode"),
        (
            lambda group: group["env_states/articulations"].move("panda", "fetch"),
            "Its robots are 'fetch'; PickCube has 1",
        ),
        (
            lambda group: group.move("actions", "old") or group.create_dataset("actions", data=[[1.0]]),
            "shape",
        ),
    ],
)
def test_a_damaged_episode_spoils_no_other(file, damage, says):
    with h5py.File(file, "r+") as content:
        damage(content["traj_0"])
    opened = ManiSkillFile(file, TASK)
    with pytest.raises(DatasetError, match=says):
        opened.read("traj_0")
    assert opened.read("traj_1").succeeded


def test_a_truncated_file_is_named(file):
    file.write_bytes(file.read_bytes()[:-5000])
    with pytest.raises(DatasetError, match=r"two\.h5' is not a complete HDF5 file .* Download it again"):
        ManiSkillFile(file, TASK)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, r"needs 'two\.json' beside it"),
        ("{", "describes no ManiSkill trajectories"),
        ("[" * 100_000, "describes no ManiSkill trajectories"),
        ('{"env_info": {}, "episodes": []}', "describes no ManiSkill trajectories .*env_id"),
        (
            '{"env_info": {"env_id": "TurnFaucet-v1"}, "episodes": []}',
            "'TurnFaucet-v1', and no registered task",
        ),
        ('{"env_info": {"env_id": "StackCube-v1"}, "episodes": []}', "Give task=StackCube"),
    ],
)
def test_the_description_beside_must_fit(file, text, says):
    beside = file.with_suffix(".json")
    if text is None:
        beside.unlink()
    else:
        beside.write_text(text)
    with pytest.raises(DatasetError, match=says):
        ManiSkillFile(file, TASK)


def test_another_control_rate_is_refused(tmp_path, played):
    file = write_maniskill(tmp_path / "slow", played, sim_config={"control_freq": 10})
    with pytest.raises(DatasetError, match="was recorded at 10 Hz; the task runs at 20 Hz"):
        ManiSkillFile(file, TASK)


def test_a_spin_in_the_world_becomes_one_in_the_body(file):
    with h5py.File(file, "r+") as content:
        # The cube's z axis is the world's x, about which it turns.
        content["traj_0/env_states/actors/cube"][0, 3:] = [0.5**0.5, 0, 0.5**0.5, 0, 0, 0, 0, 3.0, 0, 0]
    cube = ManiSkillFile(file, TASK).read("traj_0").states.objects["cube"]
    np.testing.assert_allclose(cube.ang_vel[0], [0, 0, 3.0], atol=1e-6)


def write_moments(path, env_id, task, state):
    """Writes an episode of standing still: the rows of a state, from a base 0.1 m further left."""
    episode = {"episode_id": 0, "control_mode": "pd_joint_pos", "episode_seed": 5}
    info = {"env_info": {"env_id": env_id}, "episodes": [episode]}
    path.with_suffix(".json").write_text(json.dumps(info))
    shift, count = np.array([0.0, 0.1, 0.0]), state.num_envs
    with h5py.File(path, "w") as file:
        group = file.create_group("traj_0")
        numbers = [len(robot.arm) + bool(robot.gripper_joints) for robot in task.robots]
        group["actions"] = np.zeros((count - 1, sum(numbers)))
        for theirs, ours in SCENES[env_id].objects.items():
            entity = state.objects[ours]
            rot = entity.rot.numpy()
            if theirs in ("goal_region", "goal_ee"):  # discs whose axis is x, by a quarter about y
                rot = multiply(rot, from_euler(np.array([0.0, np.pi / 2, 0.0])))
            values = np.concatenate([entity.pos.numpy() + shift, rot, np.zeros((count, 6))], 1)
            group[f"env_states/actors/{theirs}"] = values
        for index, robot in enumerate(task.robots):
            base = np.concatenate([np.array(robot.pos) + shift, robot.rot, np.zeros(6)])
            joints = state.robots[robot.name].joint_pos.numpy()
            parts = [np.tile(base, (count, 1)), joints, np.zeros_like(joints)]
            name = f"env_states/articulations/panda_wristcam-agent-{index}"
            group[name] = np.concatenate(parts, 1)
    return path


def peg_task(seed=5):
    return TASKS.get("PegInsertionSide")(**asdict(drawn_sizes(seed)))


@pytest.mark.parametrize("env_id", sorted(SCENES))
def test_things_of_every_scene_are_where_they_were_recorded(env_id, tmp_path):
    task = peg_task() if env_id.startswith("Peg") else TASKS.get(SCENES[env_id].task)()
    state = task.initial_state([np.random.default_rng(row) for row in range(3)])
    file = ManiSkillFile(write_moments(tmp_path / "still.h5", env_id, task, state), task)
    read = file.read("traj_0").states
    assert set(read.objects) == {item.name for item in task.scenario.objects}
    up = np.array([0.0, 0.0, 1.0])
    for name, entity in read.objects.items():
        expected = state.objects[name]
        np.testing.assert_allclose(entity.pos, expected.pos, atol=1e-9, err_msg=name)
        for axis in (up, np.array([1.0, 0.0, 0.0])):
            turned = rotate(entity.rot.numpy(), axis)
            np.testing.assert_allclose(turned, rotate(expected.rot.numpy(), axis), atol=1e-9, err_msg=name)
    for robot in task.robots:
        own = state.robots[robot.name].joint_pos
        np.testing.assert_array_equal(read.robots[robot.name].joint_pos, own, err_msg=robot.name)


def test_actions_of_two_robots_are_one_after_the_other(tmp_path):
    task = TASKS.get("TwoRobotPickCube")()
    state = task.initial_state([np.random.default_rng(row) for row in range(3)])
    path = write_moments(tmp_path / "two.h5", "TwoRobotPickCube-v1", task, state)
    with h5py.File(path, "r+") as content:
        content["traj_0/actions"][:] = np.r_[np.full(7, 0.1), 1.0, np.full(7, -0.2), -1.0]
    targets = ManiSkillFile(path, task).read("traj_0").targets
    left, right = np.split(targets, 2, axis=1)
    np.testing.assert_allclose(left[:, [0, 7, 8]], [[0.1, 0.04, 0.04]] * 2)
    np.testing.assert_allclose(right[:, [0, 7, 8]], [[-0.2, 0.0, 0.0]] * 2)
    with h5py.File(path, "r+") as content:
        del content["traj_0/env_states/articulations/panda_wristcam-agent-1"]
    with pytest.raises(DatasetError, match="TwoRobotPickCube has 2, and only"):
        ManiSkillFile(path, task).read("traj_0")


def test_another_robot_than_the_task_s_own_is_refused(file):
    with pytest.raises(DatasetError, match="the task's robot is 'iiwa'"):
        ManiSkillFile(file, EnvSpec(task="PickCube", robot="iiwa").make_task())


def test_sizes_of_a_peg_follow_from_the_seed_that_its_heights_tell():
    # of a recording of ManiSkill 3.0.1's motion planner: seed 2, peg and box at these heights
    sizes = peg_sizes(0.01525926, 0.1024398, 2)
    np.testing.assert_allclose(
        (sizes.peg_radius_m, sizes.peg_half_length_m), (0.01525926, 0.1024398), atol=1e-7
    )
    assert sizes == drawn_sizes(2) and max(map(abs, sizes.hole_offset_m)) < 0.06
    beside = drawn_sizes(2030)  # of the ninth environment, made once
    assert peg_sizes(beside.peg_radius_m, beside.peg_half_length_m, [2]) == beside
    with pytest.raises(DatasetError, match=r"radius of 0\.0200 m .* nor from the seeds 2022 to 6117"):
        peg_sizes(0.02, 0.105, None)


def test_an_episode_with_another_peg_says_which_options_are_its_own(tmp_path):
    task = peg_task()
    state = task.initial_state([np.random.default_rng(row) for row in range(3)])
    path = write_moments(tmp_path / "peg.h5", "PegInsertionSide-v1", task, state)
    with pytest.raises(DatasetError) as refused:
        ManiSkillFile(path, TASKS.get("PegInsertionSide")()).read("traj_0")
    words = [word for word in str(refused.value).split() if word.startswith("task_kwargs.")]
    given = compose("collect", ["task=PegInsertionSide", *words]).env.make_task()
    assert ManiSkillFile(path, given).read("traj_0").has_states
