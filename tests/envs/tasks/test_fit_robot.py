"""Another robot in a task: its hand starts where the task's own does, among the same objects."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import ConfigError, UnknownNameError
from envs.experts.actor import expert_episodes
from envs.kinematics.batched_inverse import BatchedInverseKinematics
from envs.kinematics.forward import rotation_vector
from envs.robots import ROBOTS
from envs.robots.franka import FRANKA
from envs.spec import EnvSpec
from envs.tasks import fit_robot, kept_fits
from envs.tasks.arm_contacts import ArmContacts
from envs.tasks.fit_robot import BASE_MOVES_M, fitted
from envs.tasks.make import make_task
from tests.robot_files import needs_files_of, needs_files_of_task
from tests.sweeps import sweep

ARMS = [name for name in ROBOTS.names("arm") if name != "franka"]
SHORT_ARMS = ["so101"]
"""Arms whose reach these tasks exceed; they have tasks of their own."""
OUT_OF_REACH = {("CloseBox", "jaco_2f85"), ("CloseBox", "jaco_three_finger")}
"""What is refused, since the arm with this gripper misses a pose by millimetres."""
FEWER = {"jaco": 6}
"""Successes of eight that are asked of an arm; seven of the others. PickCube's expert shows large misses."""

TASKS_OF_ARMS = ["PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding", "NutAssembly"]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Searches again, but once for all tests of this file."""
    folder = tmp_path_factory.getbasetemp() / "fit_robot_cache"
    folder.mkdir(exist_ok=True)
    monkeypatch.setattr(kept_fits, "cache_dir", lambda _: folder)


def hand(robot):
    ik = BatchedInverseKinematics(robot)
    poses = ik.chain(ik.rest[None])
    return poses.pos[0], poses.rot[0]


@pytest.mark.slow
@pytest.mark.parametrize("task", sweep(TASKS_OF_ARMS, {"PickCube"}))
@pytest.mark.parametrize("name", sweep(ARMS, {"ur5e"}))
def test_the_hand_starts_where_that_of_the_tasks_own_robot_does(task, name):
    needs_files_of(name)
    own = make_task(task).robot
    try:
        other = make_task(task, robot=name).robot
    except ConfigError as error:
        assert " mm " in str(error) or "rad/s" in str(error)
        return
    (pos, rot), (own_pos, own_rot) = hand(other), hand(own)
    assert (pos - own_pos).norm() < 0.004
    assert rotation_vector(rot @ own_rot.T).norm() < 0.03
    for joint in other.joints:
        assert joint.range[0] <= joint.default <= joint.range[1], joint.name
    for moved, allowed in zip(np.subtract(other.pos, own.pos), BASE_MOVES_M, strict=True):
        assert min(allowed) - 1e-9 <= moved <= max(allowed) + 1e-9


def test_objects_start_where_they_do_for_the_tasks_own_robot():
    mine, theirs = make_task("StackCube", robot="ur5e"), make_task("StackCube")
    starts = [task.initial_state([np.random.default_rng(5)]) for task in (mine, theirs)]
    for name in ("cube_a", "cube_b"):
        assert torch.equal(starts[0].objects[name].pos, starts[1].objects[name].pos)
    assert set(starts[0].robots) == {"ur5e"} and starts[0].robots["ur5e"].joint_pos.shape == (1, 8)


def test_a_search_is_the_same_again_and_kept(monkeypatch):
    task, robot = make_task("PickCube"), ROBOTS.get("ur5e")
    fit_robot._fitted.cache_clear()
    first = fitted(task, robot)
    fit_robot._fitted.cache_clear()
    monkeypatch.setattr(fit_robot, "_found", None)  # it is read from the cache
    assert fitted(task, robot) == first


def test_the_tasks_own_robot_changes_nothing():
    assert type(make_task("PickCube", robot="franka")) is type(make_task("PickCube"))
    with_robot = EnvSpec(robot="ur5e")
    assert EnvSpec().to_json() == {k: v for k, v in with_robot.to_json().items() if k != "robot"}
    assert EnvSpec.from_json(with_robot.to_json()) == with_robot != EnvSpec()
    assert with_robot.hash != EnvSpec().hash


def test_a_robot_that_cannot_reach_is_refused_with_what_it_lacks(monkeypatch):
    monkeypatch.setattr(fit_robot, "TOGETHER", (1, 5))
    stiff = [replace(joint, range=(joint.default - 0.3, joint.default + 0.3)) for joint in FRANKA.joints[:7]]
    short = replace(FRANKA, name="short", joints=(*stiff, *FRANKA.joints[7:]))
    message = r"'short' cannot do PickCube: its hand misses a pose of the way by \d+ mm and \d+ degrees"
    with pytest.raises(ConfigError, match=message):
        fitted(make_task("PickCube"), short)


@pytest.mark.parametrize("name", ["cartpole", "ant"])
def test_a_robot_without_a_gripper_is_refused(name):
    with pytest.raises(ConfigError, match=r"is no arm with a gripper.*roboverse list robots"):
        make_task("PickCube", robot=name)


def test_a_task_that_names_its_robot_takes_no_other():
    with pytest.raises(ConfigError, match="takes no other"):
        make_task("control/cartpole", robot="ur5e")


@pytest.mark.parametrize("task", ["PushT", "Wipe", "humanoid/slide"])
def test_a_task_of_a_tool_or_of_a_humanoid_takes_no_other(task):
    with pytest.raises(ConfigError, match="and takes no other: that is no arm with a gripper"):
        make_task(task, robot="ur5e")


def test_an_unknown_robot_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match=r"Unknown robot 'ur5'.*Did you mean 'ur5e'"):
        EnvSpec(robot="ur5").make_task()


LIBERO = "libero/object/pick_up_the_milk_and_place_it_in_the_basket"


@pytest.mark.slow
@pytest.mark.parametrize("task", ["calvin/D/open_drawer", LIBERO])
def test_tasks_of_other_benchmarks_take_another_robot(task):
    """CALVIN builds what its robot stands on, and feels it; LIBERO's files of starts hold a Franka."""
    needs_files_of_task(task)
    env = envs.make_vec(task, 4, split="test", observation="state", robot="iiwa", num_threads=1)
    own = envs.make_vec(task, 4, split="test", observation="state", num_threads=1)
    episodes = env.split_indices[:4]
    for each in (env, own):
        each.reset_envs(np.arange(4), episodes)
    ours, theirs = env.get_states(), own.get_states()
    assert set(ours.robots) == {"iiwa"} and set(theirs.robots) == {"franka"}
    for name in theirs.objects:
        torch.testing.assert_close(ours.objects[name].pos, theirs.objects[name].pos)
    mine, other = (state.robots[name].ee_pos for state, name in ((ours, "iiwa"), (theirs, "franka")))
    assert mine is not None and other is not None and (mine - other).norm(dim=-1).max() < 0.06
    outcomes = [run.success for run in expert_episodes(env, episodes.tolist())]
    assert sum(outcomes) >= 3
    env.close()
    own.close()


@pytest.mark.parametrize("task", ["calvin/D/open_drawer", LIBERO])
@pytest.mark.parametrize("space", ["action_space", "observation_space"])
def test_actions_and_observations_of_another_benchmark_are_those_of_its_robot(task, space):
    needs_files_of_task(task)
    with pytest.raises(ConfigError, match="native actions or observations has a robot of its own, 'franka'"):
        make_task(task, {space: "native"}, robot="iiwa")


def test_the_wrist_camera_of_libero_is_on_the_robot():
    needs_files_of_task(LIBERO)
    mounts = [camera.mount for camera in make_task(LIBERO, robot="iiwa").scenario.cameras]
    assert mounts == [None, "iiwa/right_hand"]


def test_contacts_of_an_arm_are_counted_and_those_of_the_gripper_are_not():
    task = make_task("PickCube")
    start = task.initial_state([np.random.default_rng(0)])
    contacts = ArmContacts(task.scenario, task.robot)
    rest = np.array(task.robot.default_qpos)
    in_the_table = rest.copy()
    in_the_table[1] = 1.7
    assert contacts.count(start, 0, [rest, in_the_table]) == 1
    start.objects["cube"].pos[:] = hand(task.robot)[0]  # between the fingers
    assert contacts.count(start, 0, [rest]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep([name for name in ARMS if name not in SHORT_ARMS], {"ur5e"}))
@pytest.mark.parametrize("task", sweep(["PickCube", "CloseBox"], {"PickCube"}))
def test_the_expert_succeeds_on_another_robot(task, name):
    if (task, name) in OUT_OF_REACH:
        with pytest.raises(ConfigError, match="misses a pose of the way by"):
            make_task(task, robot=name)
        return
    needs_files_of(name)
    env = envs.make_vec(task, 4, split="test", observation="state", robot=name)
    outcomes = [run.success for run in expert_episodes(env, env.split_indices[:8].tolist())]
    assert env.scenario.robots[0].name == name and sum(outcomes) >= FEWER.get(name, 7)
    env.close()
