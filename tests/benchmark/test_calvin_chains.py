"""CALVIN's long-horizon evaluation: scores, results that are kept, and chains of the expert."""

import dataclasses
import json

import numpy as np
import pytest

import policies
from benchmark import calvin_chains
from benchmark.calvin_chains import (
    ChainEnv,
    ChainExpert,
    ChainScores,
    ChainSettings,
    evaluate,
    main,
    run_chains,
)
from benchmark.chain_results import read_results, read_runs
from envs.core.errors import ConfigError
from envs.core.git import git_sha
from envs.spec import EnvSpec
from envs.tasks.calvin import memory
from envs.tasks.calvin.sequences import all_chains
from tests.policies.examples import CONFIGS, FEATURES, IMAGE, SIZE, stats

FIVE = ("open_drawer", "turn_on_led", "move_slider_left", "lift_red_block_table", "stack_block")
SYMBOLS = {
    "led": 0,
    "lightbulb": 0,
    "slider": "right",
    "drawer": "closed",
    "red_block": "table",
    "blue_block": "table",
    "pink_block": "slider_right",
    "grasped": 0,
}


def env(num_envs):
    return EnvSpec(task=calvin_chains.ENV_TASK).make(
        num_envs, split="test", observation="state", num_threads=1
    )


def test_scores_are_those_that_calvins_evaluation_prints():
    scores = ChainScores((5, 0, 2, 5), (FIVE,) * 4)
    assert scores.average_length == 3.0
    assert scores.rates == (0.75, 0.75, 0.5, 0.5, 0.5)
    assert scores.by_task["open_drawer"] == (3, 4)
    assert scores.by_task["move_slider_left"] == (2, 3)
    assert scores.by_task["stack_block"] == (2, 2)
    text = scores.text()
    assert text.startswith("Average successful sequence length: 3.000 (4 chains)\n")
    assert "1: 75.0%\n" in text and "open_drawer: 3 / 4 |  SR: 75.0%" in text


@pytest.mark.slow
def test_the_expert_solves_a_chain_and_each_instruction_starts_where_the_last_ended():
    made = env(1)
    instructions, starts = [], []
    real = made.set_instruction

    def set_instruction(env_id, text):
        instructions.append(text)
        starts.append(made.get_states())
        real(env_id, text)

    made.set_instruction = set_instruction
    try:
        chains = ChainEnv(made, {3: (SYMBOLS, FIVE)})
        assert list(run_chains(chains, ChainExpert(chains), [3])) == [(3, 5)]
    finally:
        made.close()
    assert instructions[:3] == [
        "pull the handle to open the drawer",
        "press the button to turn on the led light",
        "push the sliding door to the left side",
    ]
    third = starts[2]
    assert float(memory.start_joints(third)[0, 1]) > 0.1  # the drawer is open, and was when this task began
    assert [bool(value) for value in memory.led(third)] == [True, True]


@pytest.mark.slow
def test_a_chain_does_not_depend_on_those_beside_it():
    both = {0: (SYMBOLS, FIVE[:1]), 1: (SYMBOLS, ("turn_on_led",))}
    ends = []
    for number, indices in ((2, [0, 1]), (1, [0])):
        made = env(number)
        chains, end = ChainEnv(made, both), None
        for index, count in run_chains(chains, ChainExpert(chains), indices):
            assert count == 1
            if index == 0:
                end = made.get_states([0])
        ends.append(end.objects["block_red"].pos.numpy())
        made.close()
    np.testing.assert_array_equal(*ends)


@pytest.fixture
def ran(monkeypatch):
    """The chains that were run, without an environment."""
    ran = []

    def run(_env, _actor, indices):
        for index in indices:
            ran.append(index)
            yield index, index % 6

    class Env:
        def close(self):
            pass

    monkeypatch.setattr(calvin_chains, "run_chains", run)
    monkeypatch.setattr(calvin_chains, "_env", lambda *_: Env())
    monkeypatch.setattr(calvin_chains, "_actor", lambda *_: None)
    return ran


def test_results_are_kept_and_only_missing_chains_are_run(ran, tmp_path):
    path = tmp_path / "results.json"
    old = {"command": "before", "git_sha": None, "seed": 0, "solved": {"1": 4}}
    path.write_text(json.dumps({"expert": [old], "mine": [{"solved": {"0": 2}}]}))
    scores = evaluate(ChainSettings(chains=4, results=path), ["chains=4"])
    assert ran == [0, 2, 3] and scores.completed == (0, 4, 2, 3)
    assert scores.chains[0] == all_chains()[0][1]
    assert read_results(path) == {"expert": {0: 0, 1: 4, 2: 2, 3: 3}, "mine": {0: 2}}
    assert evaluate(ChainSettings(chains=2, first=2, results=path)).completed == (2, 3)
    assert ran == [0, 2, 3]


def test_results_say_by_which_command_commit_and_seed_they_were_made(ran, tmp_path):
    path = tmp_path / "results.json"
    for _ in range(2):
        evaluate(ChainSettings(chains=2, results=path), ["chains=2", f"results={path}"])
    evaluate(ChainSettings(chains=1, first=7, results=path), ["first=7", "chains=1"])
    first, second = read_runs(path)["expert"]
    assert first["command"] == "python -m benchmark.calvin_chains chains=2 results=.../results.json"
    assert first["solved"] == {"0": 0, "1": 1} and second["solved"] == {"7": 1}
    assert first["git_sha"] == git_sha() and first["seed"] == 0


def test_a_checkpoint_with_other_weights_or_another_view_is_run_anew(ran, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "config.json").write_text("{}")
    (folder / "model.safetensors").write_text("weights")
    settings = ChainSettings(checkpoint=str(folder), chains=2, results=tmp_path / "results.json")
    for _ in range(2):
        evaluate(settings)
    assert ran == [0, 1]
    evaluate(dataclasses.replace(settings, looks="meshes"))
    assert ran == [0, 1] * 2
    (folder / "model.safetensors").write_text("trained further")
    evaluate(settings)
    assert ran == [0, 1] * 3
    assert str(tmp_path) not in (tmp_path / "results.json").read_text(), "results are published"


def test_bad_input_is_reported(tmp_path, capsys):
    path = tmp_path / "results.json"
    for text in ('{"expert": [1, 2', '{"expert": {"0": 5}}', '{"expert": [{"command": "no chains"}]}'):
        path.write_text(text)
        with pytest.raises(ConfigError, match="has no results of chains"):
            read_results(path)
    assert main(["chains=2000"]) == 2 and "from 1 to 1000, given 2000" in capsys.readouterr().err
    assert main(["policy=nobody"]) == 2 and "checkpoint=<folder>" in capsys.readouterr().err


@pytest.mark.slow
def test_a_policy_that_reads_sees_the_images_of_its_training_and_is_asked_each_instruction(
    tmp_path, monkeypatch
):
    """Its images are neither of CALVIN's sizes nor the default one."""
    names = ("observation.images.static", "observation.images.gripper")
    image = FEATURES[IMAGE]
    features = {key: value for key, value in FEATURES.items() if key != IMAGE} | dict.fromkeys(names, image)
    own_stats = stats() | dict.fromkeys(names, stats()[IMAGE])
    policies.create("mtact", features, own_stats, CONFIGS["mtact"]).save(tmp_path / "policy")
    monkeypatch.setattr(calvin_chains, "STEPS_PER_TASK", 6)
    settings = ChainSettings(checkpoint=str(tmp_path / "policy"), chains=1, results=tmp_path / "results.json")
    made = calvin_chains._env(settings, 1)
    try:
        assert made.camera_names == ("static", "gripper")
        assert made.scenario.cameras[0].height == SIZE
        chains = ChainEnv(made, {0: all_chains()[0]})
        assert list(run_chains(chains, calvin_chains._actor(settings, chains), [0])) == [(0, 0)]
    finally:
        made.close()
    given = calvin_chains._images(dataclasses.replace(settings, cameras=("gripper",), image_size=84))
    assert given == {"cameras": ("gripper",), "image_size": 84}
