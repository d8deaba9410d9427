"""``roboverse sweep recipe=…``: the order of its runs, what it leaves alone, and what it refuses."""

import json
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands.run_folder import default_folder
from roboverse_learn.commands.tested_checkpoint import protocol_of
from roboverse_learn.config.compose import compose
from roboverse_learn.config.recipes import runs_in_order
from roboverse_learn.sweep import make_jobs, plan, table

TINY = (
    "policy_name: act\ncollect: {num_demos: 2}\ntrain: {steps: 3, batch_size: 2}\nevaluate: {episodes: 1}\n"
)


@pytest.fixture
def words(tmp_path):
    recipe = tmp_path / "tiny_v0.yaml"
    recipe.write_text(TINY)
    folders = [f"{key}_dir={tmp_path}/{key}" for key in ("runs", "results", "datasets")]
    return [f"recipe={recipe}", "tasks=[PickCube,StackCube]", *folders]


def write_result(config, **changes):
    """Stands for a finished run: the fields that a sweep reads, where the run would have written them."""
    protocol = protocol_of(config.evaluate)
    folder = Path(config.results_dir) / protocol.version / config.env.task / "act"
    folder.mkdir(parents=True, exist_ok=True)
    facts = {"recipe": config.recipe, "protocol_hash": protocol.hash} | changes
    (folder / f"{default_folder(config).name}.json").write_text(json.dumps(facts))


def test_seed_0_is_first_then_levels_0_and_3_and_tasks_alternate():
    runs = list(runs_in_order(["a", "b"], ["X", "Y"], (), ()))
    got = [tuple(word.partition("=")[2] for word in run) for run in runs]
    assert got[:5] == [
        ("a", "X", "0", "0"), ("b", "X", "0", "0"), ("a", "Y", "0", "0"), ("b", "Y", "0", "0"),
        ("a", "X", "3", "0"),
    ]  # fmt: skip
    blocks = list(dict.fromkeys((seed, level) for _, _, level, seed in got))
    assert blocks == [
        ("0", "0"), ("0", "3"), ("0", "1"), ("0", "2"), ("1", "0"), ("1", "3"), ("2", "0"), ("2", "3"),
    ]  # fmt: skip


def test_the_whole_table_is_96_runs():
    assert len(list(runs_in_order(["act_v1", "diffusion_v1"], (), (), ()))) == 96


def test_finished_runs_are_left_alone_by_their_results_alone(words):
    planned = plan([*words, "levels=[0]", "seeds=[0,1]"])
    first, second, third, _ = [config for _, config in planned.runs]
    write_result(first)
    write_result(second, recipe="tiny_v9")
    default_folder(third).mkdir(parents=True)
    (default_folder(third) / "config.yaml").write_text("")
    assert [line.split()[0] for line in table(planned).splitlines()[:4]] == [
        "done",
        "open",
        "started",
        "open",
    ]
    jobs, complete = make_jobs(planned)
    assert complete == [default_folder(first)]
    assert [job.words[0] for job in jobs] == ["collect", "train", "collect", "train", "train"]


def test_seeds_share_the_demonstrations(words):
    runs = plan([*words, "tasks=[PickCube]", "levels=[3]"]).runs
    assert len(runs) == 3
    assert len({dataset_folder(config) for _, config in runs}) == 1


def test_the_recipe_is_in_the_configuration_and_the_name_of_a_run(words):
    (_, config), *_ = plan(words).runs
    assert (config.recipe, config.train.steps, config.collect.num_demos) == ("tiny_v0", 3, 2)
    assert default_folder(config).name.startswith("tiny_v0-level0-seed0-")


@pytest.mark.parametrize("word", ["train.steps=5", "shift_px=4", "preset=gpu", "cameras=[front]"])
def test_no_key_changes_a_recipe(word):
    with pytest.raises(ConfigError, match="would change recipe=act_v1"):
        compose("train", ["recipe=act_v1", word])


def test_other_mistakes_are_reported_before_anything_runs():
    with pytest.raises(UnknownNameError, match="Did you mean 'act_v1'"):
        plan(["recipe=act_1"])
    with pytest.raises(ConfigError, match="add recipe="):
        plan(["tasks=[PickCube]"])
    with pytest.raises(ConfigError, match="trains policy=act"):
        compose("train", ["recipe=act_v1", "policy=diffusion"])


def test_an_unknown_version_of_recipes_lists_the_versions_beside_the_names():
    with pytest.raises(UnknownNameError, match=r"Unknown recipe 'v9'\..* Valid: act_v1,.* v1, v1a"):
        plan(["recipe=v9"])
