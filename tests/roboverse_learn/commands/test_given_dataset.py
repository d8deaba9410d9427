"""Whether a policy of a dataset can act in a task: by the names of joints, however they are written."""

from types import SimpleNamespace

from roboverse_learn.commands.dataset_layout import task_layout
from roboverse_learn.commands.given_dataset import _misfit
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
