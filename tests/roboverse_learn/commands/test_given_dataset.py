"""Datasets that are given: whose tasks a policy can tell apart, and whose joints are those of a task."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest

from envs.core.atomic import write_json
from envs.core.errors import ConfigError, DatasetError
from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.commands.given_dataset import _check_tasks, _misfit, _other_robot, given_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetWriter
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from roboverse_learn.data.sources.base import DemonstrationSource
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode


def said(rename):
    """Returns why the policy of a dataset whose joints are renamed cannot act in PickCube."""
    config = compose("train", ["task=PickCube", "policy=act"])
    features, _, _ = task_layout(config)
    renamed = {
        key: {**feature, "names": [rename(name) for name in feature["names"]]}
        for key, feature in features.items()
        if key in ("observation.state", "action")
    }
    return _misfit(SimpleNamespace(features=renamed), config, "PickCube")


def test_names_of_lerobots_robots_are_ours():
    assert said(lambda name: name) == ""
    assert said(lambda name: f"{name.replace('/', '_')}.pos") == ""


def test_other_joints_are_named():
    words = said(lambda name: name.replace("joint1", "shoulder"))
    assert words.startswith(
        "The policy is not evaluated, for it cannot act in PickCube: its observation.state"
    )
    assert "shoulder" in words


TWO_TASKS = SimpleNamespace(root="datasets/both", named_tasks=["PickCube", "StackCube"])


def test_a_policy_that_reads_no_instruction_takes_no_dataset_of_further_tasks():
    config = compose("train", ["task=PickCube", "policy=act"])
    with pytest.raises(ConfigError, match=r"episodes of StackCube, too, and policy=act reads no instruction"):
        _check_tasks(TWO_TASKS, config)
    _check_tasks(SimpleNamespace(root="datasets/one", named_tasks=["PickCube"]), config)
    _check_tasks(SimpleNamespace(root="datasets/of_others", named_tasks=[]), config)


def test_a_policy_that_reads_instructions_takes_it():
    _check_tasks(TWO_TASKS, compose("train", ["task=PickCube", "policy=mtact"]))


@pytest.fixture
def collected(tmp_path):
    """A dataset that was collected with ``cameras=[]``, which is the front camera alone."""
    root = tmp_path / "dataset"
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        writer.add_episode(make_episode(0))
    settings = DemonstrationSource(compose("collect", ["task=PickCube", "image_size=32"])).settings()
    assert list(settings["cameras"]) == []
    write_json(root / COLLECTION_PATH, {"settings": settings, "failed": []})
    return root


@pytest.mark.parametrize("words", [[], ["cameras=[front]"], ["task=PickCube", "image_size=32", "cameras=[]"]])
def test_cameras_are_compared_by_their_names(collected, words):
    config = compose("train", ["policy=act", "preset=quick", f"dataset={collected}", *words])
    assert given_dataset(config).config == config


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("cameras=[wrist]", r"begun with cameras=\['front'\]; now given: cameras=\['wrist'\]"),
        ("cameras=[all]", r"begun with cameras=\['front'\]; now given: cameras=\['front', 'wrist'\]"),
        ("image_size=64", r"begun with image_size=32; now given: image_size=64"),
        ("robot=ur5e", r"begun with robot=None; now given: robot='ur5e'"),
        ("task=StackCube", r"task='PickCube'; now given: .*task='StackCube'"),
    ],
)
def test_a_setting_that_is_given_and_differs_is_refused_with_both_values(collected, word, said):
    config = compose("train", ["policy=act", f"dataset={collected}", word])
    with pytest.raises(DatasetError, match=said + r".*Leave out what differs to take the dataset's"):
        given_dataset(config)


def merged(root, robots):
    """Writes a dataset of no collection, with an episode of each robot."""
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        for index, robot in enumerate(robots):
            episode = make_episode(index, length=2)
            writer.add_episode(replace(episode, metadata=episode.metadata | {"robot": robot}))
    return f"dataset={root}"


@pytest.mark.parametrize(
    ("robots", "acts", "said"),
    [
        ([""], "iiwa", r"demonstrations of franka, and the run is of iiwa, .* Give robot=franka, or name"),
        (["ur5e", "iiwa"], "franka", r"demonstrations of iiwa and ur5e, and the run is of franka, .*=iiwa,"),
    ],
)
def test_joints_of_other_robots_alone_are_refused_before_a_run_begins(tmp_path, robots, acts, said):
    words = ["policy=act", merged(tmp_path / "merged", robots), f"robot={acts}"]
    with pytest.raises(ConfigError, match=said):
        given_dataset(compose("train", words))


def test_raw_states_that_are_truncated_or_missing_are_found_before_a_run_begins(tmp_path):
    config = compose("train", ["policy=act", merged(tmp_path / "merged", ["", "", ""])])
    given_dataset(config)
    (tmp_path / "merged/raw/episode_000001.safetensors").rename(tmp_path / "kept")
    missing = r"episode_000001\.safetensors' is missing, and other episodes have theirs\. Restore it"
    with pytest.raises(DatasetError, match=missing):
        given_dataset(config)
    half = (tmp_path / "kept").read_bytes()[:-100]
    (tmp_path / "merged/raw/episode_000001.safetensors").write_bytes(half)
    with pytest.raises(DatasetError, match=r"episode_000001\.safetensors' is truncated or damaged"):
        given_dataset(config)
    shutil.rmtree(tmp_path / "merged/raw")  # as a dataset of another program
    given_dataset(config)


@pytest.mark.parametrize(
    ("robots", "words"),
    [
        (["", "iiwa"], ["robot=iiwa"]),
        (["", "iiwa"], []),
        (["iiwa"], []),
        ([""], ["robot=franka"]),
        (["", "ur5e"], ["robot=iiwa", "task_kwargs.action_space=hand"]),
    ],
)
def test_a_mixture_with_the_robot_and_actions_of_the_hand_are_learned_from(tmp_path, robots, words):
    found = given_dataset(compose("train", ["policy=act", merged(tmp_path / "merged", robots), *words]))
    assert found.learned["robots"] == sorted(robots)


@pytest.mark.parametrize(
    ("recorded", "acts", "said"),
    [
        (["ur5e"], "ur5e", ""),
        (["ur5e", ""], "ur5e", ""),
        (["ur5e", ""], "", ""),
        (["ur5e"], "iiwa", "was recorded with ur5e, and the policy is evaluated with iiwa."),
        ([""], "iiwa", "was recorded with franka, and the policy is evaluated with iiwa."),
        (["ur5e", "iiwa"], "", "was recorded with iiwa and ur5e, and the policy is evaluated with franka."),
    ],
)
def test_a_robot_that_recorded_nothing_is_named(recorded, acts, said):
    episodes = [{"task": "PickCube", "robot": robot} for robot in recorded]
    info = SimpleNamespace(root="datasets/arms", episode_metadata=episodes)
    words = _other_robot(info, compose("train", ["task=PickCube", *([f"robot={acts}"] if acts else [])]))
    assert said in words and bool(said) == bool(words)


def test_a_policy_of_several_tasks_is_fit_for_each_of_them_in_any_order():
    config = compose("train", ["policy=mtact", "task=[StackCube,PickCube]"])
    features, _, _ = task_layout(config)
    for task in config.tasks:
        assert _misfit(SimpleNamespace(features=features), config, task) == ""


def test_a_robot_of_another_program_is_named_by_its_kind():
    info = SimpleNamespace(root="datasets/arm", episode_metadata=[{}], robot_type="so100_follower")
    config = compose("train", ["task=so101/pick_cube"])
    assert "recorded with so100_follower, and the policy is evaluated with so101" in _other_robot(
        info, config
    )
    info.robot_type = "panda"  # a word of that program's, of which nothing is known here
    assert _other_robot(info, compose("train", ["task=PickCube"])) == ""
    for kind in ("so101_follower", None):
        info.robot_type = kind
        assert _other_robot(info, config) == ""
