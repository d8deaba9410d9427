"""``evaluate policy=…``: results of what needs no checkpoint."""

import json
from pathlib import Path

import pytest

from benchmark.instruction_scores import wording_gaps
from benchmark.results import read_result
from envs.core.errors import ConfigError, RoboVerseError, UnknownNameError
from envs.randomization.splits import SPLIT_NAMES, load_split
from envs.tasks.pick_cube import PickCube
from envs.tasks.wrong_instructions import wrong_instructions
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.config.schema import baselines
from roboverse_learn.config.serialize import from_values, to_values
from roboverse_learn.evaluate import evaluate, evaluate_all

RESULTS = Path(__file__).parents[3] / "results"
WORDS = ["task=PickCube", "levels=[0]", "splits=[test]", "episodes=2", "evaluate.num_envs=2", "videos=0"]


def result_of(policy, folder, *words):
    assert cli.main(["evaluate", f"policy={policy}", *WORDS, f"results_dir={folder}", *words]) == 0
    (path,) = folder.glob(f"*/PickCube/{policy}/*.json")
    return read_result(path)


def test_a_rule_is_evaluated_and_evaluated_once(tmp_path, capsys):
    result = result_of("random", tmp_path)
    assert "PickCube, random, without training: success in 2 episodes" in capsys.readouterr().out
    assert (result.checkpoint.hash, result.checkpoint.step, result.train_level) == (None, None, None)
    assert (result.sees_images, result.env.cameras, len(result.records)) == (False, (), 2)
    assert [record.success for record in result.records] == [False, False]
    again = result_of("random", tmp_path)
    assert again.created == result.created, "an evaluation of the same protocol is not run again"
    assert "random" in (tmp_path / "leaderboard.md").read_text()


def test_a_damaged_result_of_another_run_leaves_the_table_and_the_paths(tmp_path, capsys):
    damaged = tmp_path / "v2" / "PickCube" / "act" / "cut.json"
    damaged.parent.mkdir(parents=True)
    damaged.write_text('{"schema_version": 3')
    assert cli.main(["evaluate", "policy=random", *WORDS, f"results_dir={tmp_path}"]) == 2
    said = capsys.readouterr()
    (path,) = tmp_path.glob("v2/PickCube/random/*.json")
    assert "PickCube, random, without training: success in 2 episodes" in said.out
    assert str(path) in said.out and "leaderboard" not in said.out
    assert (
        said.err.splitlines()[-2].startswith("error: No leaderboard was written") and str(damaged) in said.err
    )


def test_a_rule_is_evaluated_in_each_of_several_tasks(tmp_path, capsys):
    words = ["task=[PickCube,PushCube]", *WORDS[1:], "policy=hold", f"results_dir={tmp_path}"]
    config = compose("evaluate", words)
    assert from_values("evaluate", to_values(config)) == config
    assert [each.result.env.task for each in evaluate_all(config)] == ["PickCube", "PushCube"]
    assert compose("evaluate", ["task=[PickCube]", "policy=hold"]).env == {"task": "PickCube"}
    assert compose("evaluate", ["task=[PickCube,PickCube]", "policy=hold"]).env == {"task": "PickCube"}
    assert cli.main(["evaluate", "task=[PickCube,]", "policy=hold"]) == 2
    assert cli.main(["evaluate", "task=[PickCube,PickCub]", "policy=hold"]) == 2
    said = capsys.readouterr().err
    assert "Unknown task ''" in said
    assert "Unknown task 'PickCub'. Did you mean 'PickCube'?" in said


def test_all_cameras_of_several_tasks_are_those_that_they_share():
    words = ["task=[PickCube,StackCube]", "cameras=[all]", "policy=hold"]
    assert (
        compose("evaluate", words).env["cameras"]
        == compose("evaluate", ["task=PickCube", *words[1:]]).env["cameras"]
    )
    with pytest.raises(ConfigError, match=r"in PickCube and \[.*\] in control/cartpole.*Name the cameras"):
        compose("evaluate", ["task=[PickCube,control/cartpole]", *words[1:]])


@pytest.mark.slow
def test_the_plots_that_are_printed_are_of_the_evaluated_task(tmp_path, capsys):
    other = next((RESULTS / "v2/CloseBox/act").glob("act_v1-level0-seed0-*.json"))
    copy = tmp_path / other.relative_to(RESULTS)
    copy.parent.mkdir(parents=True)
    copy.write_bytes(other.read_bytes())
    result_of("random", tmp_path, "levels=[0,1]")
    printed = "".join(capsys.readouterr().out.split())
    drawn = {path.name for path in (tmp_path / "plots").iterdir()}
    assert drawn == {"v2-closebox-mujoco-warp-warp.png", "v2-pickcube-mujoco-warp.png"}
    assert "plots/v2-pickcube-mujoco-warp.png" in printed and "closebox" not in printed


def test_an_unknown_device_is_refused_though_a_rule_uses_none(tmp_path, capsys):
    assert cli.main(["evaluate", "policy=random", *WORDS, f"results_dir={tmp_path}", "device=tpu"]) == 2
    assert "Unknown device 'tpu'. Valid: auto, cpu, cuda, cuda:<index>." in capsys.readouterr().err


@pytest.mark.slow
def test_the_expert_solves_what_a_policy_would_be_tested_on(tmp_path):
    expert, zero = result_of("expert", tmp_path, "videos=1"), result_of("zero", tmp_path)
    assert all(record.success for record in expert.records)
    hashes = [[record.initial_state_hash for record in each.records] for each in (expert, zero)]
    assert hashes[0] == hashes[1]
    assert all(record.length < expert.max_episode_steps for record in expert.records), "it ends at success"
    assert len(list(tmp_path.glob("*/PickCube/expert/*/*.mp4"))) == 1


def test_the_validation_split_is_evaluated_beside_the_others_and_ranked_by_nobody(tmp_path, capsys):
    every = result_of("random", tmp_path, "splits=[train,validation,test]")
    episodes = {split: [r.episode for r in every.records if r.split == split] for split in SPLIT_NAMES}
    assert episodes == {split: load_split(split).episodes[:2].tolist() for split in SPLIT_NAMES}
    table = capsys.readouterr().out.partition("evaluated on")[2]
    assert table.index("test split") < table.index("validation split") < table.index("train split")
    result_of("zero", tmp_path, "splits=[validation]")
    (section,) = json.loads((tmp_path / "leaderboard.json").read_text())["sections"]
    shown = {row["policy"]: [cell["split"] for cell in row["cells"]] for row in section["rows"]}
    assert shown == {"random": list(SPLIT_NAMES), "zero": ["validation"]}
    assert "validation" not in (tmp_path / "leaderboard.md").read_text()


@pytest.mark.slow
def test_an_evaluation_that_is_repeated_leaves_no_video_or_poster_of_the_one_before(tmp_path):
    result_of("expert", tmp_path, "videos=1")
    (result,) = tmp_path.glob("*/PickCube/expert/*.json")
    result.unlink()
    videos = result.with_suffix("")
    assert {path.suffix for path in videos.iterdir()} == {".mp4", ".png"}
    result_of("expert", tmp_path)
    assert not videos.exists() or not list(videos.iterdir())


@pytest.mark.parametrize("policy", baselines())
def test_a_baseline_survives_the_saved_configuration(policy):
    config = compose("evaluate", [f"policy={policy}", "task=PickCube", "preset=quick"])
    assert config.policy_name == policy and config.evaluate.episodes == 100
    assert from_values("evaluate", to_values(config)) == config


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["policy=randm", "task=PickCube"], UnknownNameError, "'randm'.*Did you mean 'random'"),
        (
            ["policy=act", "task=PickCube"],
            ConfigError,
            "policy=act must be trained: give its checkpoint=<folder>",
        ),
        (["policy=random", "checkpoint=runs/x", "task=PickCube"], ConfigError, "both given.*Leave one out"),
        (["policy=random"], ConfigError, "policy=random needs task=<name>"),
        ([], ConfigError, "Without one, give policy=expert or policy="),
    ],
)
def test_a_wrong_choice_is_one_sentence(words, error, message):
    with pytest.raises(error, match=message):
        compose("evaluate", words)


def test_the_expert_of_a_task_without_one_is_refused(tmp_path):
    words = ["policy=expert", "task=control/cartpole", f"results_dir={tmp_path}"]
    with pytest.raises(ConfigError, match="control/cartpole has no scripted expert"):
        evaluate(compose("evaluate", words))
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_instruction_tests_are_evaluated_and_reported(tmp_path, capsys):
    result = result_of("expert", tmp_path, "episodes=1", "instructions=[wrong,switched]", "alone=[language]")
    said = capsys.readouterr().out
    assert "success in the task when it is asked for otherwise" in said and "instruction switched" in said
    own, worded, wrong, switched = result.records
    assert worded.only == "language" and worded.instruction in PickCube().wordings(own.instruction).test
    assert wrong.instruction in wrong_instructions(PickCube()) and wrong.success, "an expert reads nothing"
    assert switched.instruction == own.instruction and switched.switched_at == own.length // 2
    assert (tmp_path / "instructions.html").exists()


@pytest.mark.slow
def test_success_with_known_and_with_new_words_is_reported(tmp_path, capsys):
    result = result_of("expert", tmp_path, "episodes=1", "instructions=[known,new_words]")
    said = capsys.readouterr().out
    assert "success with known wordings and with held-out ones" in said
    (gap,) = wording_gaps(result.records)
    assert (gap.wording, gap.known_rate, gap.held_out_rate) == ("new_words", 1.0, 1.0), (
        "an expert reads nothing"
    )
    own, known, new = result.records
    bank = PickCube().wordings(own.instruction)
    assert known.instruction in bank.known and new.instruction in bank.new_words


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["instructions=[wrong]", "levels=[1]"],
            r"=\[wrong\] .* is level 0; add it: levels=\[0,1\]\.",
        ),
        (["instructions=[wrong,empty]", "levels=[]"], r"\[wrong,empty\] .* add it: levels=\[0\]\."),
        (["instructions=[rong]"], "Did you mean 'wrong'"),
        (["instructions=[wrong]", "width=0.2"], "Leave one out"),
    ],
)
def test_instruction_tests_that_cannot_be_compared_are_errors(words, message):
    with pytest.raises(RoboVerseError, match=message):
        compose("evaluate", ["policy=random", "task=PickCube", *words])
