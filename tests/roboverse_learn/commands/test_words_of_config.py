"""The words that a configuration is written as compose to it again."""

import pytest

from roboverse_learn.commands.words_of_config import collect_words, evaluate_words
from roboverse_learn.config.compose import compose
from roboverse_learn.config.serialize import to_values


@pytest.mark.parametrize(
    "words",
    [
        ["task=PickCube"],
        ["task=StackCube", "level=3", "cameras=[front,wrist]", "num_demos=7", "collect.steps_per_look=2"],
        ["task=PickCube", "task_kwargs.cube_half_size_m=0.03", "scenario.physics.decimation=3"],
        ["suite=paper", "tasks_at_once=3"],
    ],
)
def test_words_of_a_collection(words):
    config = compose("collect", words)
    assert compose("collect", collect_words(config)) == config


def test_words_name_the_task_where_a_source_would_name_another(monkeypatch):
    monkeypatch.setattr("policies.checkpoint.learned_tasks", lambda checkpoint: ("StackCube",))
    words = ["source=policy", "checkpoint=runs/x"]
    for task in ("PickCube", "CloseBox"):
        config = compose("collect", [f"task={task}", *words])
        assert f"task={task}" in collect_words(config)
        assert compose("collect", collect_words(config)) == config


@pytest.mark.parametrize(
    "words",
    [
        ["checkpoint=runs/x"],
        [
            "checkpoint=runs/a b",
            "task=StackCube",
            "levels=[0,3]",
            "splits=[test]",
            "instructions=[known,wrong]",
        ],
        ["policy=expert", "task=PickCube", "alone=[camera]", "width=0.1", "device=cpu", "results_dir=/x/y"],
        ["checkpoint=x", "rename_map={front: camera1}", "task_kwargs.variant=lift", "cameras=[front]"],
        [
            "checkpoint=x",
            "scenario.physics.decimation=3",
            "simulator=mujoco_warp",
            "simulator_settings.njmax=768",
        ],
        ["checkpoint=x", "preset=quick", "episodes=3"],
        ["checkpoint=x", "suite=libero_10", "protocol=libero"],
    ],
)
def test_words_of_an_evaluation(words):
    config = compose("evaluate", words)
    assert to_values(compose("evaluate", evaluate_words(config))) == to_values(config) | {"preset": "full"}
