"""``roboverse_learn.api``: the commands as functions."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import policies
from envs.core.errors import ConfigError, PolicyError, UnknownNameError
from envs.tasks import TASKS
from envs.tasks.pick_cube import PickCube
from roboverse_learn import api
from roboverse_learn.config.compose import compose

TINY = {"episodes": 2, "levels": [0], "splits": ["test"], "videos": 0}


@pytest.mark.parametrize(
    ("command", "words", "given"),
    [
        ("train", ["policy=diffusion", "level=3"], {"policy": "diffusion", "level": 3}),
        ("train", ["preset=quick", "train.steps=5"], {"preset": "quick", "train": {"steps": 5}}),
        ("train", ["recipe=act_v1"], {"recipe": "act_v1"}),
        ("collect", ["num_demos=4", "cameras=[front]"], {"num_demos": 4, "cameras": ("front",)}),
        ("collect", ["cameras=front"], {"cameras": "front"}),
        ("collect", ["scenario.physics.decimation=50"], {"scenario": {"physics": {"decimation": 50}}}),
    ],
)
def test_settings_of_a_call_mean_what_the_words_of_a_command_do(command, words, given):
    assert compose(command, [], given) == compose(command, words)


def test_an_unknown_setting_is_an_error_with_the_nearest_one():
    with pytest.raises(UnknownNameError, match=r"num_demo.*Did you mean 'collect\.num_demos'"):
        api.collect("PickCube", num_demo=4)


def test_a_setting_of_the_wrong_type_is_an_error():
    with pytest.raises(ConfigError, match="num_demos"):
        api.collect("PickCube", num_demos="many")


@pytest.mark.parametrize("chunk", [None, 4])
def test_a_function_is_a_policy(chunk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = []

    def hold(observation):
        seen.append({key: np.shape(value) for key, value in observation.items()})
        actions = np.zeros((len(observation["observation.state"]), 9), np.float32)
        return actions if chunk is None else np.repeat(actions[:, None], chunk, 1)

    (evaluation,) = api.evaluate(hold, "PickCube", num_envs=2, **TINY)
    assert seen[0]["observation.state"] == (2, 9) and "observation.environment_state" in seen[0]
    assert not any(key.startswith("observation.images") for key in seen[0])
    assert len(seen) == evaluation.result.max_episode_steps / (chunk or 1)
    (cell,) = evaluation.result.cells()
    assert (cell.successes, cell.episodes) == (0, 2) and evaluation.path is None
    assert not list(tmp_path.iterdir()), "nobody could repeat it: no file says so"


def test_a_function_gets_the_images_of_the_cameras_that_are_named():
    shapes = {}

    def look(observation):
        shapes.update({key: np.shape(value) for key, value in observation.items()})
        return np.zeros((2, 200, 9), np.float32)

    api.evaluate(look, "PickCube", cameras=["wrist"], image_size=32, **TINY)
    assert shapes["observation.images.wrist"] == (2, 32, 32, 3)


def test_a_function_is_evaluated_in_each_of_several_tasks():
    found = api.evaluate(lambda seen: seen["observation.state"], ["PickCube", "PushCube"], **TINY)
    assert [each.result.env.task for each in found] == ["PickCube", "PushCube"]


def test_a_policy_is_evaluated_as_the_baseline_of_its_name_is(tmp_path):
    from envs.spec import EnvSpec

    space = EnvSpec(task="PickCube").make(1).single_action_space
    (given,) = api.evaluate(policies.create_scripted("random", space), "PickCube", **TINY)
    (named,) = api.evaluate("random", "PickCube", results_dir=str(tmp_path), **TINY)
    assert named.path is not None and named.path.is_file()
    pairs = zip(given.result.records, named.result.records, strict=True)
    assert all(
        (a.episode, a.length, a.episode_return) == (b.episode, b.length, b.episode_return) for a, b in pairs
    )
    assert "policy=random" in named.result.command and "task=PickCube" in named.result.command


def test_actions_of_a_wrong_shape_are_an_error():
    with pytest.raises(PolicyError, match=r"shape \(9,\).*Return actions \(n, action_dim\)"):
        api.evaluate(lambda _: np.zeros(9), "PickCube", **TINY)


def test_a_checkpoint_can_be_given_by_its_key(tmp_path):
    for given in ({"policy": tmp_path}, {"checkpoint": tmp_path}, {"checkpoint": str(tmp_path)}):
        with pytest.raises(PolicyError, match=f"Checkpoint '{tmp_path}' has no config"):
            api.evaluate(**given, task="PickCube", results_dir=str(tmp_path / "results"))


def test_nothing_to_evaluate_is_an_error_that_says_what_to_give():
    with pytest.raises(ConfigError, match=r"needs checkpoint=<folder>.*policy=expert or policy=hold"):
        api.evaluate(task="PickCube")


def test_a_misspelt_policy_is_an_error_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"Unknown key 'polcy' of evaluate\. Did you mean 'policy'"):
        api.evaluate(polcy="random", task="PickCube")


@pytest.mark.parametrize("policy", ["random", "some/folder", lambda _: np.zeros((2, 9))])
def test_a_policy_and_a_checkpoint_are_one_too_many(policy):
    with pytest.raises(ConfigError, match=r"A policy and checkpoint=x are both given.*Leave one out"):
        api.evaluate(policy, "PickCube", checkpoint="x")


def test_a_function_needs_a_task():
    with pytest.raises(ConfigError, match="needs a task"):
        api.evaluate(lambda _: np.zeros((2, 9)))


def test_what_cannot_be_called_is_no_policy():
    with pytest.raises(ConfigError, match=r"'5' is no policy\. Give the folder of a checkpoint"):
        api.evaluate(5, "PickCube")  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class _Higher(PickCube):
    name: ClassVar[str] = "HigherCube"


def test_a_task_that_is_registered_nowhere_can_be_given(tmp_path, monkeypatch):
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    root = tmp_path / "demos"
    small = {"num_demos": 2, "image_size": 32, "cameras": ["front"], "dataset": str(root)}
    summary = api.collect(_Higher(), **small)
    assert summary.num_episodes == 2 and (root / "meta/info.json").is_file()
    (evaluation,) = api.evaluate("expert", _Higher, results_dir=str(tmp_path / "results"), **TINY)
    assert all(record.success and record.task == "HigherCube" for record in evaluation.result.records)


def test_a_class_with_the_name_of_another_task_is_an_error():
    @dataclass(frozen=True)
    class Other(PickCube):
        name: ClassVar[str] = "StackCube"

    with pytest.raises(ConfigError, match="'StackCube' is registered already"):
        api.evaluate("expert", Other())


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_the_whole_loop_in_python(tmp_path):
    folders = {f"{name}_dir": str(tmp_path / name) for name in ("datasets", "runs", "results")}
    small = {"num_demos": 2, "image_size": 32, "cameras": ["front"], "train": {"steps": 2, "batch_size": 2}}
    settings = small | folders | TINY | {"preset": "quick", "device": "cpu"}
    run = api.train("act", "PickCube", **settings)
    assert run is not None and run.checkpoint.is_dir() and "num_episodes=2" in str(run.dataset)
    assert [len(each.result.records) for each in run.evaluations] == [2]
    (again,) = api.evaluate(run.folder, results_dir=folders["results_dir"], **TINY)
    assert again.reused and again.result.records == run.evaluations[0].result.records


def test_a_check_says_what_is_broken(monkeypatch):
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))

    class Speechless(PickCube):
        name = "Speechless"
        instructions = ()

    kept, broken = (api.check(task, contracts=["options", "words"]) for task in ("PickCube", Speechless))
    assert kept.ok and not kept.failures
    assert not broken.ok and list(broken.failures) == ["words"]
