"""The YAML files of configs/: which of them wins, and that each can be reached."""

import itertools

import pytest
import yaml

import policies
from envs.tasks import TASKS
from roboverse_learn.config.command_line_keys import at, flat_keys
from roboverse_learn.config.compose import compose, configs_folder, preset_names
from roboverse_learn.config.recipes import recipe_names
from roboverse_learn.config.serialize import default_values, to_values


def test_command_line_overrides_yaml_overrides_dataclass() -> None:
    default = default_values("train")["collect"]["num_demos"]
    quick = yaml.safe_load((configs_folder() / "policy_preset" / "quick_act.yaml").read_text())["collect"][
        "num_demos"
    ]
    assert default != quick
    assert compose("train", []).collect.num_demos == default
    assert compose("train", ["preset=quick"]).collect.num_demos == quick
    assert compose("train", ["preset=quick", "num_demos=7"]).collect.num_demos == 7
    assert compose("train", ["num_demos=7", "preset=quick", "num_demos=8"]).collect.num_demos == 8


def test_a_preset_of_a_policy_wins_over_the_policy() -> None:
    full, quick = compose("train", ["policy=act"]), compose("train", ["policy=act", "preset=quick"])
    assert quick.policy.dim_model < full.policy.dim_model
    assert quick.train.batch_size < full.train.batch_size
    assert type(quick.policy) is type(full.policy) is policies.config_class("act")


@pytest.mark.slow
@pytest.mark.parametrize("policy", policies.names())
def test_locomotion_preset_changes_only_ppo_horizon_settings(policy: str) -> None:
    plain, legs = (
        to_values(compose("train", [f"policy={policy}", f"preset={name}"])) for name in ("full", "locomotion")
    )
    of_ppo = {"num_envs", "num_steps", "gamma", "lam", "init_std", "desired_kl"} if policy == "ppo" else set()
    changed = {key for key in flat_keys(plain) if at(plain, key) != at(legs, key)}
    assert changed == {"preset"} | {f"policy.{key}" for key in of_ppo}
    assert policy != "ppo" or legs["policy"]["gamma"] > plain["policy"]["gamma"]


@pytest.mark.slow
@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("policy", policies.names())
def test_every_yaml_composes(policy: str, preset: str) -> None:
    compose("train", [f"preset={preset}", f"policy={policy}"])


def test_every_yaml_is_reachable() -> None:
    known = {f"preset/{name}" for name in preset_names()} | {f"policy/{name}" for name in policies.names()}
    known |= {f"policy_preset/{preset}_{policy}" for preset in preset_names() for policy in policies.names()}
    of_tasks = itertools.product(TASKS.names(), preset_names(), policies.names())
    known |= {f"task_preset/{task}/{preset}_{policy}" for task, preset, policy in of_tasks}
    known |= {f"recipe/{name}" for name in recipe_names(configs_folder() / "recipe")}
    found = {
        path.relative_to(configs_folder()).with_suffix("").as_posix()
        for path in configs_folder().rglob("*.y*ml")
    }
    assert found - {"run"} <= known


@pytest.mark.parametrize("task", ["NutAssembly", "[NutAssembly]"])
def test_a_task_has_what_it_needs_of_its_own_in_a_preset(task: str) -> None:
    words = ["preset=quick", f"task={task}"]
    longer, plain = compose("train", words), compose("train", ["preset=quick"])
    assert longer.policy.chunk_size == 80 > plain.policy.chunk_size
    assert longer.policy.dim_model == plain.policy.dim_model
    assert compose("train", [*words, "policy.chunk_size=40"]).policy.chunk_size == 40
    diffusion = compose("train", [*words, "policy=diffusion"])
    assert diffusion.train == compose("train", ["preset=quick", "policy=diffusion"]).train


def test_preset_does_not_change_the_evaluated_scene() -> None:
    config = compose("evaluate", ["checkpoint=runs/x", "preset=quick"])
    assert config.env == {}
    assert config.evaluate.episodes == compose("train", ["preset=quick"]).evaluate.episodes
    assert compose("evaluate", ["checkpoint=runs/x", "preset=quick", "image_size=64"]).env == {
        "image_size": 64
    }
