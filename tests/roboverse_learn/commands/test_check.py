"""``roboverse check``: what it prints, its exit code, and what it refuses."""

import pytest

from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.pick_cube import PickCube
from roboverse_learn import cli
from roboverse_learn.check import check
from roboverse_learn.config.compose import compose

QUICK = ["contracts=[options,words,initial_states]"]


@pytest.mark.parametrize("word", ["task=PickCube", "PickCube"])
def test_contracts_that_hold_are_a_table_and_exit_code_0(
    word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", word, *QUICK]) == 0
    said = capsys.readouterr().out
    assert "task PickCube" in said and "3 instructions, 100 steps" in said
    assert "4 contracts: 4 ok, 0 failed, 0 skipped." in said


def test_a_broken_contract_says_what_to_mend_and_is_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    TASKS.add("Speechless", type("Speechless", (PickCube,), {"name": "Speechless", "instructions": ()}))
    assert cli.main(["check", "task=Speechless", *QUICK]) == 1
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "instructions is empty. Give a tuple of sentences that say what to do." in said
    assert "1 failed" in said and "Mend what failed, and look at it alone with contracts=[<name>]." in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["task=PickCub"], "Unknown task 'PickCub'. Did you mean 'PickCube'?"),
        (["contracts=[scen]"], "Unknown contract 'scen'. Did you mean 'scene'?"),
        (["without=[expert]"], "Unknown contract 'expert'."),
        (["policy=atc"], "Unknown policy 'atc'. Did you mean 'act'?"),
        pytest.param(["policy=ppo"], "policy=ppo does not learn from demonstrations", marks=pytest.mark.slow),
        (["robot=frank"], "Unknown robot 'frank'. Did you mean 'franka'?"),
        (["episodes=0"], "episodes must be 1 to 1000, given 0."),
        (["required=2"], "required is a share from 0 to 1, given 2.0."),
        (["task=PickCube", "task_kwargs.variant=lfit"], "Unknown variant of PickCube 'lfit'."),
    ],
)
def test_a_wrong_word_is_one_sentence(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", *words]) == 2
    assert capsys.readouterr().err.startswith(f"error: {said}")


def test_keys_of_an_environment_and_the_size_of_a_preset_apply() -> None:
    config = compose("check", ["task=PickCube", "task_kwargs.variant=lift", "simulator=mujoco_warp"])
    assert config.env == EnvSpec(task_kwargs={"variant": "lift"}, simulator="mujoco_warp", image_size=64)
    assert config.policy_name == "" and compose("check", ["policy=act"]).policy_name == "act"
    assert compose("check", ["policy=act"]).env.cameras == ("front", "wrist")
    assert compose("check", ["preset=full"]).env.image_size == 256


@pytest.mark.slow
def test_a_policy_is_checked_on_the_observations_of_the_task() -> None:
    words = ["policy=act", "task=DrawerOpen", "contracts=[acts]", "image_size=32"]
    checked = check(compose("check", words))
    assert checked.what == "policy act on DrawerOpen" and checked.ok
    assert checked.findings[-1].detail == "10 actions of 4 numbers"


@pytest.mark.slow
def test_a_robot_is_checked_alone() -> None:
    checked = check(compose("check", ["robot=franka", "contracts=[scene]"]))
    assert [finding.name for finding in checked.findings] == ["joints", "scene"] and checked.ok
