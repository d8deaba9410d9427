"""What policies are asked in an instruction test, and whether the score tells those that read from others."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmark import videos
from benchmark.instruction_scores import instruction_scores, wording_gaps
from benchmark.instruction_tests import Script, check_instruction_tests
from benchmark.protocol import INSTRUCTION_TESTS, NOT_ASKED, Protocol
from benchmark.runner import Baseline, evaluate
from envs.core.errors import ConfigError
from envs.experts.actor import ExpertActor
from envs.randomization.language import WordingBank, bank_of
from envs.rollout import Actor
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube
from envs.tasks.wrong_instructions import wrong_instructions

OWN = "reach the goal"
BANK = WordingBank((OWN, "please reach the goal"), ("now do reach the goal",), ("touch the goal",))
ALL = Protocol(levels=(0,), splits=("test",), episodes=12, instructions=INSTRUCTION_TESTS)
UNDERSTOOD = {*BANK.known, *BANK.new_frame}
"""What the reader below knows: known words in any frame."""


@pytest.fixture
def worded(point_env, monkeypatch):
    """Returns a function that makes the small env with a task that can be worded, and a wrong instruction."""
    monkeypatch.setattr("benchmark.instruction_tests._wrong_of", lambda task: ("sweep the floor",))

    class Worded(point_env):
        def __init__(self, num_envs=1):
            super().__init__(num_envs, split_size=12)
            words = {"description": OWN, "wordings": lambda instruction: BANK}
            self.task = SimpleNamespace(**vars(self.task), **words)
            self.words = [""] * num_envs

        def reset_envs(self, env_ids, episodes):
            super().reset_envs(env_ids, episodes)
            for env_id in env_ids:
                self.words[env_id] = OWN

        def instruction(self, env_id):
            return self.words[env_id]

        def set_instruction(self, env_id, instruction):
            self.words[env_id] = instruction

        def observe(self, env_ids):
            return super().observe(env_ids) | {"task": np.array([self.words[i] for i in env_ids])}

    return Worded


class Scripted:
    """Goes to the goal: always, or where the instruction asks for it, as far as it reads."""

    batch_invariant, n_obs_steps, n_action_steps = True, 1, 1

    def __init__(self, *, reads):
        self._reads = reads
        self.asked = []

    def act(self, observation, generators=()):
        del generators
        self.asked += observation["task"].tolist()
        state = observation["observation.state"]
        goal = np.repeat(state[:, None, -1:], 9, axis=2)
        here = np.concatenate([state[:, :8], state[:, :1]], axis=1)[:, None]
        goes = np.array([not self._reads or text in UNDERSTOOD for text in observation["task"]])
        return np.where(goes[:, None, None], goal, here + np.sign(here - goal))


def scores_of(worded, num_envs=4, *, reads):
    policy = Scripted(reads=reads)
    records = evaluate(policy, lambda cell: worded(num_envs), ALL, policy_name="scripted")
    return {score.instruction_test: score for score in instruction_scores(records)}, records, policy


def test_a_policy_that_ignores_its_instruction_scores_0(worded):
    scores, records, _ = scores_of(worded, reads=False)
    assert all(record.success for record in records)
    for test in NOT_ASKED:
        assert (scores[test].right_rate, scores[test].test_rate, scores[test].difference) == (1.0, 1.0, 0.0)
        assert scores[test].ci_low < 0 < scores[test].ci_high and scores[test].p_value == 1.0


def test_a_policy_that_reads_scores_its_success(worded):
    """It understands known words in a new frame, and no new words: 12 of 12 against 0 of 12."""
    scores, _, _ = scores_of(worded, reads=True)
    assert {test: score.test_rate for test, score in scores.items()} == {
        "known": 1.0,
        "new_frame": 1.0,
        "new_words": 0.0,
        "wrong": 0.0,
        "empty": 0.0,
        "switched": 0.0,
    }
    for test in (*NOT_ASKED, "new_words"):
        assert scores[test].difference == 1.0 and scores[test].ci_low > 0.5
        assert scores[test].p_value == pytest.approx(2 * 0.5**12)
    assert scores["known"].difference == scores["new_frame"].difference == 0.0


def test_known_words_are_told_from_new_ones(worded):
    """A policy that knows known words in any frame loses nothing to new frames and all to new words."""
    for reads, cost in ((True, 1.0), (False, 0.0)):
        gaps = {gap.wording: gap for gap in wording_gaps(scores_of(worded, reads=reads)[1])}
        assert gaps["new_frame"].difference == 0.0 and gaps["new_words"].difference == cost
        assert (gaps["new_words"].known_rate, gaps["new_words"].held_out_rate) == (1.0, 1.0 - cost)
        assert (gaps["new_words"].ci_low > 0.5) == reads


def test_records_say_what_was_asked_and_when_it_was_switched(worded):
    _, records, policy = scores_of(worded, reads=False)
    by_test = {
        test: [r for r in records if r.instruction_test == test] for test in (None, *INSTRUCTION_TESTS)
    }
    assert {r.instruction for r in by_test[None]} == {OWN} == {r.instruction for r in by_test["switched"]}
    assert {r.instruction for r in by_test["known"]} == {*BANK.known}
    assert {r.instruction for r in by_test["new_frame"]} == {*BANK.new_frame}
    assert {r.instruction for r in by_test["new_words"]} == {*BANK.new_words}
    assert {r.instruction for r in by_test["wrong"]} == {"sweep the floor"}
    assert {r.instruction for r in by_test["empty"]} == {""}
    for right, switched in zip(by_test[None], by_test["switched"], strict=True):
        assert switched.switched_at == right.length // 2 and switched.switched_to == "sweep the floor"
    assert all(r.switched_at is None for test, rows in by_test.items() if test != "switched" for r in rows)
    asked = policy.asked[-sum(r.length for r in by_test["switched"]) :]
    assert asked.count(OWN) == sum(r.switched_at for r in by_test["switched"])


def test_words_do_not_depend_on_the_number_of_envs(worded):
    one, many = (
        [record.to_json() | {"wall_time_s": 0} for record in scores_of(worded, n, reads=True)[1]]
        for n in (1, 5)
    )
    assert one == many


def test_a_video_shows_what_was_evaluated(worded, monkeypatch):
    """The reader fails the switched episode in its video as it did before."""
    _, records, policy = scores_of(worded, reads=True)
    record = next(r for r in records if r.instruction_test == "switched")
    env = worded()
    frames, success = videos.record_episode(policy, env, record.episode, seed=0, script=Script.of(record))
    assert not success and env.words == ["sweep the floor"] and len(frames) == record.length // 2 + 1
    _, success = videos.record_episode(policy, env, record.episode, seed=0)
    assert success


def test_a_test_that_a_task_has_no_words_for_is_an_error_at_once():
    bank = bank_of(("frobnicate",))
    task: Any = SimpleNamespace(name="Odd", description="frobnicate", wordings=lambda text: bank)
    check_instruction_tests(task, ("known", "new_frame", "empty"))
    with pytest.raises(ConfigError, match=r"'frobnicate', has no wording of the kind 'new_words'.*Leave new"):
        check_instruction_tests(task, ("new_words",))


class Reader(Actor):
    """Acts as the expert where the instruction asks for the task, and holds still where not."""

    n_obs_steps = 1

    def __init__(self, env):
        self._expert = ExpertActor(env)
        self._asked = {*bank_of(PickCube.instructions).known}

    def begin(self, episodes):
        return self._expert.begin(episodes)

    def act(self, episodes, states):
        (episode,) = episodes
        observation = episode.observations[-1]
        if str(observation["task"]) in self._asked:
            return self._expert.act(episodes, states)
        return [np.repeat(observation["observation.state"][None], 10, axis=0)]


class ReadingExpert(Baseline):
    """The expert, if it is asked."""

    def actor(self, env, seed, where):
        return Reader(env)


@pytest.mark.slow
def test_in_the_simulator_the_score_separates_a_policy_that_reads_from_one_that_does_not():
    protocol = Protocol(levels=(0,), splits=("test",), episodes=1, instructions=("known", "wrong"))

    def make(cell):
        return EnvSpec(task="PickCube", image_size=16).make(1, split=cell.split, observation="state")

    found = {}
    for name, policy in (("reader", ReadingExpert("expert")), ("expert", Baseline("expert"))):
        records = evaluate(policy, make, protocol, policy_name=name)
        found[name] = [score.difference for score in instruction_scores(records)]
        wrong = {r.instruction for r in records if r.instruction_test == "wrong"}
        assert wrong <= {*wrong_instructions(PickCube())}
    assert found == {"reader": [0.0, 1.0], "expert": [0.0, 0.0]}
