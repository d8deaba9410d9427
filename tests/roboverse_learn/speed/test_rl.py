"""What learning by reward costs, of a few worlds on a CPU: it runs, and compares like with like."""

import json

import pytest
import torch

pytest.importorskip("rsl_rl")
pytest.importorskip("stable_baselines3")
pytest.importorskip("torchrl")

from envs.torch_env import EnvStep
from policies.ppo.config import PpoConfig
from roboverse_learn.speed import BENCHMARKS, rl, solving
from roboverse_learn.speed.bare_env import BareEnv

TINY = PpoConfig(num_envs=2, num_steps=2, num_minibatches=1, num_epochs=1, hidden_dims=(8,))


def test_it_is_registered():
    assert BENCHMARKS.entry("rl").target == "roboverse_learn.speed.rl"


def test_both_envs_look_alike_to_an_agent():
    ours, bare = solving.make_env(2, "cpu"), BareEnv(2, "cpu")
    names = ("num_envs", "observation_size", "action_size", "max_episode_steps")
    assert all(getattr(ours, name) == getattr(bare, name) for name in names)
    actions = torch.zeros(2, 5)
    for env in (ours, bare):
        step = env.step(actions)
        assert isinstance(step, EnvStep) and step.obs.shape == (2, 47) and step.obs.isfinite().all()
    ours.close()


def test_the_bare_env_moves_its_arm_and_begins_anew():
    env = BareEnv(2, "cpu")
    first = env.reset().clone()
    moved = env.step(torch.ones(2, 5)).obs
    assert not torch.equal(moved[:, :9], first[:, :9])
    env.elapsed_steps[0] = env.max_episode_steps - 1
    step = env.step(torch.ones(2, 5))
    assert step.truncated.tolist() == [True, False] and not step.terminated.any()
    torch.testing.assert_close(step.obs[0, :16], first[0, :16])
    assert not torch.equal(step.final_obs[0, :16], step.obs[0, :16])


def test_steps_of_ppo_are_compared():
    measured = rl.measure_throughput(TINY, "cpu", turns=1, rollouts=1)
    assert measured.ours_s > 0 < measured.baseline_s
    assert measured.ratio == pytest.approx(measured.baseline_s / measured.ours_s)
    assert measured.name == "a step of PPO, 2 worlds on cpu, bare mujoco_warp / ours"


def test_what_an_adapter_adds_is_a_part_of_a_step():
    measured = rl.measure_adapters(2, "cpu", num_steps=1)
    assert all(name in each.name for name, each in zip(("rsl_rl", "sb3", "torchrl"), measured, strict=True))
    for each in measured:
        assert each.ratio == pytest.approx(each.ours_s / each.baseline_s - 1.0)
        assert each.ratio > -0.01 and "goal ≤ 0.05" in each.goal


class Never:
    """A policy's network that closes the hand and stays."""

    @staticmethod
    def model(seen):
        return torch.zeros(len(seen), 5)


def test_an_idle_policy_solves_nothing():
    env = solving.make_env(2, "cpu", split="test")
    env.max_episode_steps = 2
    assert solving.success_on(env, Never()) == 0.0
    env.close()


@pytest.mark.parametrize(
    ("found", "seconds", "slices"), [((0.2, 0.96, 1.0), 1e4, 2), ((0.0, 0.0, 0.0), 1e-9, 1)]
)
def test_training_stops_when_the_task_is_solved_or_its_time_is_over(
    found, seconds, slices, monkeypatch, tmp_path
):
    answers = iter(found)
    monkeypatch.setattr(solving, "success_on", lambda *_: next(answers))
    monkeypatch.setattr(solving, "NUM_SLICES", 10**9)
    solved = solving.solve(TINY, "cpu", seconds, tmp_path)
    assert [success for *_, success in solved.curve] == list(found[:slices])
    assert (solved.reached_s is not None) == ("95 % after" in str(solved)) == (slices == 2)


def test_words_are_checked_and_what_was_measured_is_kept(tmp_path, capsys):
    assert rl.main(["parts=[solves]"]) == 2
    assert "part of this benchmark 'solves'. Did you mean 'solve'" in capsys.readouterr().err
    assert rl.main(["world=2"]) == 2
    assert "benchmarks.rl 'world'. Did you mean 'worlds'" in capsys.readouterr().err
    policy = "policy={num_steps: 2, num_minibatches: 1, num_epochs: 1}"
    words = ["parts=[solve]", "worlds=2", "seconds=0.001", policy, "backend=torchrl", f"out={tmp_path}"]
    assert rl.main([*words, "device=cpu"]) == 0
    (kept,) = json.loads((tmp_path / "rl.json").read_text())
    assert (kept["backend"], kept["seed"], kept["num_envs"]) == ("torchrl", 0, 2)
    assert (tmp_path / "torchrl-seed0" / "metrics.jsonl").is_file()
