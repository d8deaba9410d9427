"""CALVIN's long-horizon evaluation: scores, results that are kept, and chains of the expert."""

import json
import subprocess
import sys

import numpy as np
import pytest

from benchmark import calvin_chains
from benchmark.calvin_chains import ChainEnv, ChainExpert, ChainScores, evaluate_chains, run_chains
from benchmark.chain_results import ChainResults, read_results, read_runs
from benchmark.runner import Baseline
from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from envs.tasks.calvin import memory
from envs.tasks.calvin.sequences import all_chains

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


def env(num_envs, **task_kwargs):
    return EnvSpec(task=calvin_chains.ENV_TASK, task_kwargs=task_kwargs).make(
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


@pytest.mark.slow
def test_the_expert_acts_in_calvins_own_actions_too():
    made = env(1, action_space="native")
    try:
        chains = ChainEnv(made, {0: (SYMBOLS, FIVE[:2])})
        assert list(run_chains(chains, ChainExpert(chains), [0])) == [(0, 2)]
    finally:
        made.close()


def test_results_are_kept_and_only_missing_chains_are_run(monkeypatch, tmp_path):
    ran = []

    def run(_env, _actor, indices):
        for index in indices:
            ran.append(index)
            yield index, index % 6

    class Env:
        protocol_seed = 0

        def close(self):
            ran.append("closed")

    monkeypatch.setattr(calvin_chains, "run_chains", run)
    path, counts = tmp_path / "results.json", []
    old = {"command": "before", "git_sha": "abc", "seed": 0, "solved": {"1": 4}}
    path.write_text(json.dumps({"expert": [old], "mine": [{"solved": {"0": 2}}]}))

    def evaluate(first, count):
        results = ChainResults(path, "expert", {"command": "now", "git_sha": "abc", "seed": 0})
        make_env = lambda number: counts.append(number) or Env()  # noqa: E731
        return evaluate_chains(Baseline("expert"), make_env, range(first, first + count), results)

    scores = evaluate(0, 4)
    assert ran == [0, 2, 3, "closed"] and counts == [3] and scores.completed == (0, 4, 2, 3)
    assert scores.chains[0] == all_chains()[0][1]
    assert read_results(path) == {"expert": {0: 0, 1: 4, 2: 2, 3: 3}, "mine": {0: 2}}
    assert evaluate(2, 2).completed == (2, 3) and counts == [3]
    before, now = read_runs(path)["expert"]
    assert before == old and now == {
        "command": "now",
        "git_sha": "abc",
        "seed": 0,
        "solved": {"0": 0, "2": 2, "3": 3},
    }


def test_a_policy_is_shown_by_the_chains_of_one_commit_and_seed(tmp_path):
    path, facts = tmp_path / "chains.json", {"command": "before", "git_sha": "abc", "seed": 0}
    for index in range(3):
        ChainResults(path, "mine", facts).add(index, 5)
    for index in (7, 8):
        ChainResults(path, "mine", facts | {"git_sha": "def"}).add(index, 1)
    assert read_results(path) == {"mine": {0: 5, 1: 5, 2: 5}}
    ChainResults(path, "mine", facts | {"git_sha": "def", "command": "again"}).add(9, 2)
    assert read_results(path) == {"mine": {7: 1, 8: 1, 9: 2}}


@pytest.mark.parametrize("other", [{"git_sha": "1234"}, {"git_sha": None}, {"seed": 1}])
def test_chains_of_another_commit_or_seed_are_run_again(other, tmp_path):
    path, facts = tmp_path / "chains.json", {"command": "now", "git_sha": "abc", "seed": 0}
    ChainResults(path, "mine", facts | other).add(0, 5)
    now = ChainResults(path, "mine", facts)
    assert now.done == {}
    now.add(0, 3)
    assert ChainResults(path, "mine", facts).done == {0: 3}
    assert [run["solved"] for run in read_runs(path)["mine"]] == [{"0": 5}, {"0": 3}]


def test_results_that_two_processes_add_alternately_are_all_kept(tmp_path):
    path = tmp_path / "results" / "chains.json"
    facts = {"command": "first", "git_sha": None, "seed": 0}
    first, same = (ChainResults(path, "expert", facts) for _ in range(2))
    part = ChainResults(path, "expert", facts | {"command": "part"})
    other = ChainResults(path, "mine", facts)
    for index in (0, 10):
        first.add(index, 1)
        other.add(index, 2)
        same.add(index + 1, 3)
        part.add(index + 2, 4)
    assert read_runs(path) == {
        "expert": [
            facts | {"solved": {"0": 1, "1": 3, "10": 1, "11": 3}},
            facts | {"command": "part", "solved": {"2": 4, "12": 4}},
        ],
        "mine": [facts | {"solved": {"0": 2, "10": 2}}],
    }
    assert first.done == {0: 1, 10: 1}


def test_processes_that_add_at_the_same_time_lose_nothing(tmp_path):
    path = tmp_path / "chains.json"
    code = (
        "import sys; from pathlib import Path; from benchmark.chain_results import ChainResults\n"
        "run = {'command': 'c', 'git_sha': None, 'seed': 0}\n"
        "results = ChainResults(Path(sys.argv[1]), sys.argv[2], run)\n"
        "for index in range(40): results.add(index, 5)"
    )
    processes = [subprocess.Popen([sys.executable, "-c", code, path, label]) for label in ("a", "b")]
    assert [process.wait() for process in processes] == [0, 0]
    assert read_results(path) == {label: dict.fromkeys(range(40), 5) for label in ("a", "b")}


@pytest.mark.parametrize(
    "text", ['{"expert": [1, 2', '{"expert": {"0": 5}}', '{"expert": [{"command": "no chains"}]}']
)
def test_a_damaged_file_of_results_is_reported(text, tmp_path):
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match="has no results of chains"):
        read_results(path)
