"""What is said where an environment is not the scene of recorded states."""

import pytest

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from roboverse_learn.config.compose import compose
from roboverse_learn.data.dataset.merge import merge
from roboverse_learn.data.dataset.recorded_scene import check_not_merged, check_same_scene
from roboverse_learn.data.sources import SOURCES
from tests.roboverse_learn.data.augmentation.expert_demos import write_demos


@pytest.mark.parametrize(
    ("recorded", "given", "said"),
    [
        (
            {},
            "ur5e",
            "recorded with the task's own robot, and robot=ur5e was requested. Its states belong to their "
            "own scene alone: leave out robot=. For demonstrations of 'ur5e': source=retarget from=demos "
            "robot=ur5e.",
        ),
        (
            {"robot": "ur5e"},
            "",
            "recorded with robot=ur5e, and the task's own robot was requested. Its states belong to their "
            "own scene alone: give robot=ur5e. For demonstrations of 'franka': source=retarget from=demos "
            "robot=franka.",
        ),
    ],
)
def test_another_robot_is_named_with_what_to_do(recorded, given, said):
    metadata = {"task": "PickCube"} | recorded
    with pytest.raises(ConfigError) as refused:
        check_same_scene("demos", metadata, EnvSpec(robot=given), ("task", "robot"))
    assert str(refused.value) == f"The dataset 'demos' was {said}"
    check_same_scene("demos", metadata, EnvSpec(robot=recorded.get("robot", "")), ("task", "robot"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            "PickCube",
            "recorded with task=StackCube, and task=PickCube was requested. Its states belong to their own "
            "scene alone: give task=StackCube.",
        ),
        (
            "CloseBox",
            "recorded with task=StackCube, and task=CloseBox was requested. Its states belong to their own "
            "scene alone: give task=StackCube.",
        ),
    ],
)
def test_another_task_is_named_with_what_to_give(given, said):
    with pytest.raises(ConfigError) as refused:
        check_same_scene("demos", {"task": "StackCube"}, EnvSpec(task=given))
    assert str(refused.value) == f"The dataset 'demos' was {said}"


@pytest.fixture(scope="module")
def merged(tmp_path_factory):
    """Merged datasets of several tasks and of several robots; tests only read them."""
    place = tmp_path_factory.mktemp("merged")
    pick = write_demos(place / "pick", "PickCube", 1)
    stack = write_demos(place / "stack", "StackCube", 1)
    other = write_demos(place / "other", "PickCube", 1, robot="ur5e")
    merge([pick, stack], place / "tasks")
    merge([pick, other], place / "robots")
    return place


@pytest.mark.slow
@pytest.mark.parametrize("source", ["augment", "rerender", "retarget"])
@pytest.mark.parametrize("words", [[], ["task=PickCube"], ["task=StackCube"], ["robot=ur5e"]], ids=str)
@pytest.mark.parametrize(("name", "found"), [("tasks", "PickCube, StackCube"), ("robots", "franka, ur5e")])
def test_a_merged_dataset_is_refused_in_the_same_words_whatever_task_and_robot_are_given(
    merged, source, words, name, found
):
    folder = merged / name
    config = compose("collect", [f"source={source}", f"from={folder}", "image_size=16", *words])
    with pytest.raises(ConfigError) as refused:
        SOURCES.get(source)(config).check()
    assert str(refused.value) == (
        f"The dataset '{folder}' has episodes of several {name} ({found}). Give the datasets that it was "
        "merged of, one by one."
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tasks", "robots"])
def test_a_merged_dataset_is_refused_also_where_the_demonstrations_that_are_taken_are_of_one(merged, name):
    words = ["source=augment", f"from={merged / name}", "image_size=16", "augment.num_sources=1"]
    with pytest.raises(ConfigError, match=f"has episodes of several {name} "):
        SOURCES.get("augment")(compose("collect", words)).check()


def test_a_robot_that_is_named_and_is_the_tasks_own_is_one_robot():
    check_not_merged("demos", [{"task": "PickCube"}, {"task": "PickCube", "robot": "franka"}])
