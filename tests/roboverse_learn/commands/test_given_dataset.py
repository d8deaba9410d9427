"""Datasets that are given: whose tasks a policy can tell apart, and whose joints are those of a task."""

from types import SimpleNamespace

import pytest

from envs.core.errors import ConfigError
from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.commands.given_dataset import _check_tasks, _misfit
from roboverse_learn.config.compose import compose


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
