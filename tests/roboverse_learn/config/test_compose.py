"""Configurations: precedence, shorthand, round trips, and what no word may do."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import policies
from envs.core.errors import ConfigError, RoboVerseError, UnknownNameError
from envs.tasks.suites import suite_tasks
from roboverse_learn import cli
from roboverse_learn.config.command_line_keys import at, flat_keys, typed_key
from roboverse_learn.config.compose import compose, preset_names
from roboverse_learn.config.path_keys import PATH_KEYS
from roboverse_learn.config.schema import COMMANDS
from roboverse_learn.config.serialize import default_values, from_values, to_values
from tests.roboverse_learn.config.other_values import another

REQUIRED = {
    "evaluate": ["checkpoint=runs/x"],
    "replay": ["dataset=datasets/x"],
    "new": ["name=LiftBlock"],
}
QUICK = settings(max_examples=25, deadline=None)


def typed(value: Any) -> str:
    """A value as one would type it."""
    return json.dumps(value) if not isinstance(value, str) else value


OF_LEROBOT = (
    *("rename_map", "policy.rename_map", "policy.settings", "policy.type", "policy.peft.method_type"),
    *("policy.peft.target_modules", "policy.peft.full_training_modules", "policy.peft.lora_alpha"),
    "policy.peft.init_type",
)
"""Keys that need each other, or a map; tests/policies/zoo/test_keys.py sets them."""

ALL_KEYS = [
    (command, policy, key)
    for command in COMMANDS
    for policy in (policies.names() if command == "train" else ["act"])
    for key in flat_keys(default_values(command, policy))
    if (command, key) != ("train", "suite")  # which says what to do instead
    and key not in ("policy_name", "scenario", "preset", "run", *OF_LEROBOT)
    and not key.endswith(("task_kwargs", "simulator_settings", "launcher_settings"))
    and (policy == "act" or key.startswith("policy."))  # the others are the same for every policy
]


@pytest.mark.slow
@pytest.mark.parametrize(("command", "policy", "key"), ALL_KEYS, ids=lambda value: str(value))
def test_every_key_can_be_set_and_survives_the_saved_configuration(
    command: str, policy: str, key: str
) -> None:
    value = another(key, at(default_values(command, policy), key))
    words = [*REQUIRED.get(command, []), *([f"policy={policy}"] if command == "train" else [])]
    beside = {"source": "path=r.h5", "path": "source=robosuite", "cert": "key=k.pem", "key": "cert=c.pem"}
    beside |= {"chains": "suite=calvin", "first_chain": "suite=calvin chains=1"}
    beside["only_corrections"] = "source=teleop path=r"
    beside["policy.bank_wordings"] = "policy.swap_wordings=true"
    beside["policy.peft.r"] = "policy.path=base peft.method_type=LORA"
    beside["policy.num_inference_steps"] = "policy.head=flow" if policy == "mtact" else ""
    beside["policy.sentence_noise"] = "policy.text_encoder=."
    for name in ("conv_channels", "n_residual_blocks"):
        beside[f"policy.{name}"] = "policy.vision_backbone=keypoints"
    words += beside.get(key, "").split()
    augments = command in ("collect", "train") and key.startswith(("augment.", "from_dataset"))
    words += ["source=augment", "task=PickCube", "from=datasets/few"] if augments else []
    of_a_table = command == "sweep" and key in ("tasks", "levels", "seeds", "policies")
    words += ["recipe=act_v1"] if of_a_table else []
    words += ["source=policy"] if key == "checkpoint" and command in ("collect", "train") else []
    config = compose(command, [*words, f"{key}={typed(value)}"])
    assert at(to_values(config), key) == value
    saved = yaml.safe_load(yaml.safe_dump(to_values(config)))
    assert from_values(command, saved) == config
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(config, dataclasses.fields(config)[0].name, "elsewhere")


@pytest.mark.parametrize(("task", "cameras"), [("PickCube", ("front", "wrist")), ("DrawerOpen", ("front",))])
def test_all_cameras_are_those_of_the_task(task: str, cameras: tuple[str, ...]) -> None:
    assert compose("collect", [f"task={task}", "cameras=[all]"]).env.cameras == cameras


@QUICK
@given(
    key=st.from_regex(r"[a-z_]{1,12}(\.[a-z_]{1,12}){0,2}", fullmatch=True),
    command=st.sampled_from([name for name in COMMANDS if name != "sweep"]),  # which takes train's keys
)
def test_any_unknown_key_is_one_line_and_exit_code_2(key: str, command: str) -> None:
    import contextlib
    import io

    known = flat_keys(default_values(command))
    assume(key != "policy" and not key.startswith(("task_kwargs.", "simulator_settings.")))
    assume(not key.startswith("scenario."))
    assume(not any(full == key or full.endswith(f".{key}") for full in known))
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        assert cli.main([command, *REQUIRED.get(command, []), f"{key}=1"]) == 2
    assert said.getvalue().startswith(f"error: Unknown key '{key}' of {command}.")
    assert said.getvalue().count("\n") == 1


@QUICK
@given(
    key=st.sampled_from(
        [key for _, _, key in ALL_KEYS if key.startswith(("train.", "collect.", "evaluate."))]
    ),
    value=st.text(st.characters(blacklist_categories=("Cs", "Cc")), max_size=12),
)
def test_any_value_is_taken_or_refused_as_a_mistake(key: str, value: str) -> None:
    try:
        config = compose("train", [f"{key}={value}"])
    except RoboVerseError as error:
        assert "\n" not in str(error)
    else:
        assert from_values("train", to_values(config)) == config


@QUICK
@given(seed=st.integers(0, 2**31), lr=st.floats(1e-9, 1.0), levels=st.sets(st.integers(0, 3), min_size=1))
def test_numbers_arrive_as_they_were_typed(seed: int, lr: float, levels: set[int]) -> None:
    config = compose(
        "train", [f"seed={seed}", f"train.lr={lr!r}", f"levels={sorted(levels)}".replace(" ", "")]
    )
    assert (config.seed, config.train.lr, config.evaluate.levels) == (seed, lr, tuple(sorted(levels)))


@pytest.mark.slow
@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("command", [name for name in COMMANDS if "preset" in default_values(name)])
def test_every_command_that_has_presets_takes_all_of_them(command: str, preset: str) -> None:
    compose(command, [*REQUIRED.get(command, []), f"preset={preset}"])


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_composes(command: str) -> None:
    assert type(compose(command, REQUIRED.get(command, []))) is COMMANDS[command]


@pytest.mark.parametrize(
    ("word", "of", "value"),
    [
        ("levels=0", lambda config: config.evaluate.levels, (0,)),
        ("splits=test", lambda config: config.evaluate.splits, ("test",)),
        ("alone=camera", lambda config: config.evaluate.alone, ("camera",)),
        ("cameras=wrist", lambda config: config.env.cameras, ("wrist",)),
    ],
)
def test_one_value_is_a_list_of_one(word, of, value) -> None:
    assert of(compose("train", [word])) == value


@pytest.mark.parametrize("word", ["levels=", "levels=true", "levels=null"])
def test_what_is_no_value_is_no_list_of_one(word: str) -> None:
    with pytest.raises(
        ConfigError, match=r"evaluate\.levels: input should be a list in brackets, such as \[1,2\], given"
    ):
        compose("train", [word])


LIST = r"Write a list in brackets, such as \[1,2\]"


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("collect.num_envs=[1,2", r"cannot be read: .* collect\.num_envs takes one value, such as .*=8\.$"),
        ("only=[", r"cannot be read: check its brackets and quotes\. only takes one value\.$"),
        ("cameras=front,wrist", rf"gives several values\. {LIST.replace('1,2', 'front,wrist')}\.$"),
        ("level=range(3)", r"gives several values\. level takes one value, such as level=0\.$"),
        (
            "image_size={a:1}",
            r"gives keys of its own\. image_size takes one value, such as image_size=256\.$",
        ),
        ("scenario.cameras.front.pos=1.2,0,0.8", rf"gives several values\. {LIST}, and text "),
        (
            "scenario.cameras.front.pos=(1,2)",
            rf"cannot be read: .* {LIST}, and text with other signs in quotes",
        ),
    ],
)
def test_unreadable_value_says_what_to_write(word: str, said: str) -> None:
    with pytest.raises(ConfigError, match=f"^'{re.escape(word)}' {said}"):
        compose("collect", [word])
    if "several" in said:
        with pytest.raises(ConfigError, match=rf"For a run with each of them: roboverse sweep {word[:5]}"):
            compose("train", [word])


def test_a_level_that_does_not_exist_is_named() -> None:
    with pytest.raises(ConfigError, match=r"Unknown level 7\. Valid: 0, 1, 2, 3"):
        compose("evaluate", ["checkpoint=runs/x", "levels=7"])


@pytest.mark.parametrize(
    ("command", "word", "said"),
    [
        ("collect", "level=camera", r"'camera' is a channel: give only=camera\."),
        ("train", "level=camra", r"Did you mean 'only=camera'\?"),
        ("train", "level=hardest", r"Channels and named levels are given by only=<name>"),
        ("collect", "level=1.5", r"lighting\.$"),
        ("train", "evaluate.levels=[0,camera]", r"'camera' is a channel: give alone=\[camera\]\."),
        ("evaluate", "levels=[camera]", r"'camera' is a channel: give alone=\[camera\]\."),
    ],
)
def test_a_level_that_is_no_number_says_which_key_takes_it(command: str, word: str, said: str) -> None:
    given = word.partition("=")[2].strip("[]").split(",")[-1]
    with pytest.raises(ConfigError, match=rf"Unknown level '{given}'\. Valid levels: 0: task; .*{said}"):
        compose(command, ["checkpoint=runs/x", word] if command == "evaluate" else [word])


@pytest.mark.parametrize(
    ("word", "nearest"), [("policy", "policy="), ("polcy", "policy="), ("taks", "task="), ("leve", "level=")]
)
def test_word_without_a_value_suggests_nearest_key(word: str, nearest: str) -> None:
    with pytest.raises(ConfigError, match=rf"'{word}' is not key=value\. Did you mean '{nearest}'\?"):
        compose("train", [word])


@pytest.mark.parametrize("word", ["task_kwargs.variant=lift", "scenario.physics.decimation=50"])
def test_key_of_an_open_section_overrides_a_saved_run(word: str, tmp_path: Path) -> None:
    before = to_values(compose("train", ["scenario.room=null"]))
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(before))
    config = compose("train", [f"run={tmp_path}", word])
    section, _, rest = word.partition(".")
    assert at(getattr(config.env, section), rest.partition("=")[0]) in ("lift", 50)
    assert config.env.scenario["room"] is None


def test_a_saved_configuration_with_an_unknown_key_is_refused() -> None:
    values = to_values(compose("train", []))
    values["train"]["momentum"] = 0.9
    with pytest.raises(UnknownNameError, match=r"Unknown key 'train\.momentum' of train"):
        from_values("train", values)


def test_a_saved_configuration_of_a_wrong_type_is_refused() -> None:
    values = to_values(compose("train", []))
    values["train"]["steps"] = "many"
    with pytest.raises(ConfigError, match=r"train\.steps: input should be a valid integer.*given 'many'"):
        from_values("train", values)


def test_a_suite_is_learned_as_its_tasks_by_a_policy_of_several():
    config = compose("train", ["policy=mtact", "suite=paper"])
    assert config.tasks == suite_tasks("paper") and config.suite == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["policy=act", "suite=paper"], "suite=paper has several tasks, and this policy learns one"),
        (["policy=mtact", "suite=paper", "task=PickCube"], "task=PickCube and suite=paper are both given"),
        (["policy=mtact", "suite=papr"], "Unknown suite 'papr'. Did you mean 'paper'?"),
    ],
)
def test_a_suite_that_cannot_be_learned_is_refused(words, said):
    with pytest.raises(RoboVerseError, match=re.escape(said)):
        compose("train", words)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("policy=ppo dataset=d num_demos=3", "dataset= and num_demos= choose demonstrations, and policy=ppo"),
        ("policy=tdmpc2 collect.num_demos=3", "num_demos= chooses demonstrations, and policy=tdmpc2"),
        ("policy=fasttd3 source=augment from=d", "source= and from= choose demonstrations, and policy=f"),
        ("policy=ppo augment.retries=3", "augment.retries= chooses demonstrations, and policy=ppo"),
    ],
)
def test_demonstrations_for_a_policy_that_reads_none_are_refused(words: str, named: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{re.escape(named)}.*learns from its environment.*: act, diff"):
        compose("train", words.split())


def test_settings_of_a_machine_are_accepted_beside_every_policy() -> None:
    for words in (["datasets_dir=d", "num_workers=2"], ["preset=quick"], ["policy.expert_starts=0.5"]):
        assert compose("train", ["policy=ppo", *words]).policy_name == "ppo"
    assert compose("train", ["policy=act", "num_demos=3", "dataset=d"]).collect.num_demos == 3


def test_a_key_of_a_file_or_folder_is_not_empty() -> None:
    found = set()
    for command in COMMANDS:
        for key in [key for key in flat_keys(default_values(command, "lerobot")) if key in PATH_KEYS]:
            for value in ("", " "):
                with pytest.raises(ConfigError, match=rf"^{typed_key(key)}= is empty, and names a file or f"):
                    own = ["policy=lerobot"] if command == "train" else []
                    compose(command, [*own, f"{typed_key(key)}={value}"])
            found.add(key)
    assert found == PATH_KEYS - {"assets_dir"}


def test_a_program_may_pass_on_an_empty_default_and_no_other_empty_folder() -> None:
    assert compose("collect", (), {"dataset": "", "materials": ""}).dataset == ""
    with pytest.raises(ConfigError, match=r"^results_dir= is empty"):
        compose("leaderboard", (), {"results_dir": ""})
