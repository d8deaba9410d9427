"""What ``roboverse dataset info`` says of a dataset."""

import pytest

from roboverse_learn.commands.dataset_contents import contents
from roboverse_learn.data import DatasetInfo, DatasetWriter
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode

SCENE = {
    "task": "PickCube", "robot": "ur5e", "level": 3, "only": None, "split": "train", "simulator": "mujoco",
    "renderer": "warp", "task_kwargs": {},
}  # fmt: skip


@pytest.fixture
def lines(tmp_path):
    def of(*metadata, instructions=("lift the cube",)):
        with DatasetWriter(tmp_path / "dataset", fps=20, features=FEATURES, robot_type="franka") as writer:
            for index, facts in enumerate(metadata):
                episode = make_episode(index, task=instructions[index % len(instructions)])
                episode.metadata = facts
                writer.add_episode(episode)
        return contents(DatasetInfo.open(tmp_path / "dataset"))

    return of


def test_scene_numbers_cameras_and_instructions_are_named(lines):
    found = lines(SCENE, SCENE, instructions=("lift the cube", "raise it"))
    assert found == [
        "2 episodes of PickCube with ur5e, level 3, train split, simulated by mujoco, rendered by warp",
        "state: 3 numbers (joint0, joint1, joint2)",
        "action: 2 numbers (x, y)",
        "cameras: front of 32 × 32 pixels",
        "further columns: next.reward, next.success",
        "instructions: lift the cube; raise it",
    ]


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({}, "^1 episode of PickCube with ur5e, level 3, train"),
        ({"robot": ""}, "^1 episode of PickCube with franka, level 3, train"),
        ({"only": "camera", "level": None}, "^1 episode of PickCube with ur5e, only camera, train"),
        ({"task_kwargs": {"variant": "lift"}}, "^1 episode of PickCube variant=lift with ur5e, level 3"),
        ({"source": "augment"}, "rendered by warp, augmented$"),
        ({"source": "teleop"}, "rendered by warp, teleoperated$"),
        ({"source_robot": "franka"}, "rendered by warp, retargeted from franka$"),
        ({"look": 1}, "rendered by warp, rendered again$"),
        ({"source": "robosuite"}, "rendered by warp, from robosuite$"),
        ({"level": None}, "^1 episode of PickCube with ur5e, train split"),
    ],
)
def test_an_episode_says_what_it_is_of_and_what_made_it(lines, facts, said):
    assert said in f"^{lines(SCENE | facts)[0]}$"


def test_scenes_of_a_merged_dataset_are_counted_the_most_frequent_first(lines):
    found = lines(*[SCENE | {"level": level} for level in (0, 3, 3)])
    assert found[0].startswith("2 episodes of PickCube with ur5e, level 3")
    assert found[1].startswith("1 episode of PickCube with ur5e, level 0")


def test_many_scenes_and_instructions_are_cut(lines):
    texts = [f"lift cube {index}" for index in range(15)]
    found = lines(*[SCENE | {"task": f"Task{index}"} for index in range(15)], instructions=texts)
    assert "… and 3 further scenes" in found
    assert found[-1].endswith("; lift cube 11; … and 3 more")


def test_a_dataset_that_names_no_scene_has_its_other_lines(lines):
    assert lines({})[0] == "state: 3 numbers (joint0, joint1, joint2)"
