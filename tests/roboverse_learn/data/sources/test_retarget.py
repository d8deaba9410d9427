"""Demonstrations of one robot become those of another, the same on any number of environments."""

from dataclasses import replace

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.kinematics.forward import KinematicChain
from envs.randomization import load_split
from envs.spec import EnvSpec
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, dataset_hash, read_raw
from roboverse_learn.data.retargeting import check
from tests.roboverse_learn.data.augmentation.expert_demos import write_demos

TRAIN = load_split("train").episodes.tolist()
SCENE = ["task=PickCube", "image_size=16", "num_workers=1"]


@pytest.fixture(scope="session")
def demos(tmp_path_factory):
    """A dataset of three demonstrations of PickCube by the Franka, without images; tests only read it."""
    return write_demos(tmp_path_factory.mktemp("retarget") / "PickCube", "PickCube", 3)


def config(demos, *words, num_envs=2):
    made = compose("collect", ["source=retarget", f"from={demos}", *SCENE, *words])
    return replace(made, collect=replace(made.collect, num_envs=num_envs))


@pytest.mark.slow
def test_another_arm_solves_the_task_and_says_whose_hand_it_followed(demos, tmp_path):
    one = collect_dataset(config(demos, "robot=ur5e", "num_demos=3", f"dataset={tmp_path / 'one'}"))
    assert one.outcome == "3 of 3 retargeted demonstrations were kept (100.0 %)"
    info = DatasetInfo.open(one.root)
    assert (info.robot_type, info.num_episodes) == ("ur5e", 3)
    source = DatasetInfo.open(demos).episode_metadata
    for number, facts in enumerate(info.episode_metadata):
        assert (facts["source"], facts["source_robot"], facts["robot"]) == ("retarget", "franka", "ur5e")
        assert facts["dataset"] == dataset_hash(demos)[:16]
        assert (facts["demonstration"], facts["episode"]) == (number, source[number]["episode"])
        assert facts["split"] == "train" and facts["max_error_m"] < 1e-3 and facts["max_error_rad"] < 1e-2
    # The objects start where they were recorded, and the cube ends where the recording brought it.
    ours, theirs = read_raw(one.root, 0)[0], read_raw(demos, 0)[0]
    np.testing.assert_allclose(ours["objects/cube/pos"][0], theirs["objects/cube/pos"][0])
    np.testing.assert_allclose(ours["objects/cube/pos"][-1], theirs["objects/cube/pos"][-1], atol=0.02)
    two = config(demos, "robot=ur5e", "num_demos=3", f"dataset={tmp_path / 'two'}", num_envs=1)
    assert collect_dataset(two).dataset_hash == one.dataset_hash
    assert collect_dataset(two).num_attempts == 3  # complete: nothing is run again


@pytest.mark.long
def test_a_retargeted_dataset_is_retargeted_back(demos, tmp_path):
    collect_dataset(config(demos, "robot=iiwa", "num_demos=1", f"dataset={tmp_path / 'iiwa'}"))
    back = collect_dataset(config(tmp_path / "iiwa", "num_demos=1", f"dataset={tmp_path / 'franka'}"))
    info = DatasetInfo.open(back.root)
    assert (info.robot_type, info.episode_metadata[0]["source_robot"]) == ("franka", "iiwa")


@pytest.mark.slow
def test_more_demonstrations_than_num_demos_are_said_to_be_of_before(demos, tmp_path):
    words = ["robot=ur5e", f"dataset={tmp_path / 'made'}"]
    assert collect_dataset(config(demos, *words, "num_demos=3")).outcome.endswith("were kept (100.0 %)")
    more = collect_dataset(config(demos, *words, "num_demos=2"))
    assert more.num_episodes == 3
    assert more.outcome.endswith("; the dataset had them before, and num_demos=2 takes none away")


@pytest.mark.slow
def test_fewer_demonstrations_than_num_demos_are_said_to_be_all_that_the_dataset_holds(demos, tmp_path):
    made = collect_dataset(config(demos, "robot=ur5e", "num_demos=50", f"dataset={tmp_path / 'made'}"))
    assert made.num_episodes == 3
    assert made.outcome == (
        f"3 of 3 retargeted demonstrations were kept (100.0 %); num_demos=50 is not reached: from={demos} "
        "holds 3 demonstrations, and each gives one at most"
    )
    usual = collect_dataset(config(demos, "robot=ur5e", f"dataset={tmp_path / 'made'}"))
    assert usual.outcome == "3 of 3 retargeted demonstrations were kept (100.0 %)"  # nobody gave the 1000


@pytest.mark.slow
def test_only_episodes_that_solve_the_task_are_kept(demos, tmp_path, monkeypatch):
    from roboverse_learn.data.retargeting.planner import RetargetPlanner

    plan = RetargetPlanner.plan

    def missing_the_second(self, state, paths):
        found = plan(self, state, paths)
        return [
            one._replace(targets=one.targets[:3]) if path.num_steps == second else one
            for one, path in zip(found, paths, strict=True)
        ]

    second = len(read_raw(demos, 1)[0]["robots/franka/joint_pos"]) - 1
    monkeypatch.setattr(RetargetPlanner, "plan", missing_the_second)
    made = collect_dataset(config(demos, "robot=ur5e", "num_demos=3", f"dataset={tmp_path / 'made'}"))
    assert made.outcome == "2 of 3 retargeted demonstrations were kept (66.7 %)"
    assert [facts["demonstration"] for facts in DatasetInfo.open(made.root).episode_metadata] == [0, 2]


@pytest.mark.slow
def test_scene_and_robot_must_fit_the_dataset(demos, monkeypatch):
    with pytest.raises(ConfigError, match=r"source=retarget needs from=<folder>: a dataset of another robot"):
        compose("collect", [*SCENE, "source=retarget"])
    with pytest.raises(ConfigError, match=r"is of 'franka' already\. Give another robot, as in robot=ur5e"):
        collect_dataset(config(demos))
    with pytest.raises(
        ConfigError, match=r"with no task_kwargs, and task_kwargs\.variant=lift was requested"
    ):
        collect_dataset(config(demos, "robot=ur5e", "task_kwargs.variant=lift"))
    with monkeypatch.context() as patched:
        both = [{"task": "PickCube"}, {"task": "PickCube", "robot": "iiwa"}]
        patched.setattr(DatasetInfo, "episode_metadata", both)
        with pytest.raises(ConfigError, match=r"of several robots \(franka, iiwa\)\. Give the datasets that"):
            collect_dataset(config(demos, "robot=ur5e"))
    other = compose("collect", ["source=retarget", f"from={demos}", "robot=ur5e", "task=StackCube"])
    with pytest.raises(ConfigError, match=r"recorded with task=PickCube, and task=StackCube was requested"):
        collect_dataset(other)


def test_folder_names_dataset_and_robot(demos):
    name = dataset_folder(config(demos, "robot=ur5e", "num_demos=3")).name
    assert name.endswith("-3demos-retarget-PickCube-robot=ur5e")


@pytest.mark.slow
def test_check_prints_a_row_for_each_robot(demos, caplog):
    with caplog.at_level("INFO"):
        words = [f"from={demos}", "task=PickCube", "episodes=2"]
        assert check.main([*words, "robots=[ur5e]"]) == 0
        assert check.main(words) == 2
    assert "| ur5e | 2 of 2 (100 %) |" in caplog.text
    assert "Name the robots that follow, as in robots=iiwa,ur5e." in caplog.text


def test_check_begins_no_table_where_a_robot_is_unknown(tmp_path, caplog):
    with caplog.at_level("INFO"):
        assert check.main([f"from={tmp_path}", "task=PickCube", "robots=[ur5e,iiwaa]"]) == 2
    assert "Unknown robot 'iiwaa'. Did you mean 'iiwa'?" in caplog.text
    assert "| PickCube |" not in caplog.text


@pytest.mark.slow
def test_a_simulator_that_steps_all_environments_together_keeps_the_same(demos, monkeypatch):
    """All paths are then followed in one batch, on the device of the simulator where it is a GPU."""
    made = config(demos, "robot=ur5e")
    alone = check.check_retargeting(made, 3)
    monkeypatch.setattr("envs.simulators.mujoco.handler.MujocoHandler.steps_together", True, raising=False)
    together = check.check_retargeting(made, 3)
    assert alone.kept == together.kept == 3
    assert max(alone.missed_m, together.missed_m) < 1e-3


@pytest.mark.slow
def test_targets_of_the_arm_put_its_hand_where_the_recorded_targets_put_theirs(demos, tmp_path):
    """Both chains are computed here, apart from what the source uses, with the base of each robot."""
    import torch

    collect_dataset(config(demos, "robot=ur5e", "num_demos=1", f"dataset={tmp_path / 'made'}"))
    ours, theirs = read_raw(tmp_path / "made", 0)[0], read_raw(demos, 0)[0]
    hands = []
    for robot, raw in (("ur5e", ours), ("franka", theirs)):
        cfg = EnvSpec(task="PickCube", robot="" if robot == "franka" else robot).make_task().robot
        np.testing.assert_allclose(raw[f"robots/{robot}/pos"][0], cfg.pos, atol=1e-6)
        chain = KinematicChain(cfg)
        targets = torch.from_numpy(raw[f"robots/{robot}/joint_target"][1:])
        hands.append(chain(targets[:, chain.columns]).pos.numpy())
    steps = slice(10, min(len(hands[0]), len(hands[1])))  # the start of the arm is its own
    np.testing.assert_allclose(hands[0][steps], hands[1][steps], atol=1e-3)
