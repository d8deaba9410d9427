"""From the words of the command line to a checkpoint that the benchmark's runner evaluates."""

from pathlib import Path

import numpy as np
import pytest

import envs
import policies
from benchmark.runner import evaluate_cell
from envs.core.errors import ConfigError, PolicyError, RoboVerseError
from roboverse_learn.config.compose import compose
from roboverse_learn.evaluate import evaluate
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter

WORDS = {
    "fasttd3": (
        "num_envs=4", "policy.batch_size=32", "actor_dim=16", "critic_dim=16", "learning_starts=2",
        "buffer_size=400", "steps=24",
    ),
    "tdmpc2": (
        "num_envs=4", "policy.batch_size=8", "model_size=1", "enc_dim=16", "mlp_dim=16", "latent_dim=16",
        "num_samples=16", "num_elites=4", "num_pi_trajs=4", "iterations=2", "seed_steps=16",
        "buffer_size=400", "steps=24",
    ),
}  # fmt: skip


SHOWN = [
    line.split()[1:]
    for line in (Path(__file__).parents[4] / "docs/agents.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("roboverse ")
]


@pytest.fixture(scope="module", params=sorted(WORDS))
def trained(request, tmp_path_factory):
    words = [word if word != "num_envs=4" else "policy.num_envs=4" for word in WORDS[request.param]]
    words += ["simulator=mujoco", "save_every=12", "log_every=12", "train.num_threads=1"]
    config = compose("train", [f"policy={request.param}", "task=PickCube", *words])
    folder = tmp_path_factory.mktemp(request.param)
    result = learner_of(config, "cpu").learn(folder, None, 3, Reporter())
    return request.param, config, folder, result


@pytest.mark.slow
def test_a_run_ends_with_a_policy(trained):
    name, _, folder, result = trained
    assert (result.steps, result.stopped_by) == (24, "steps")
    assert result.loss is not None and np.isfinite(result.loss)
    assert [row["step"] for row in read_metrics(folder)][-1] == 24
    policy = policies.load(folder)
    assert type(policy) is policies.policy_class(name)
    assert policy.task == "PickCube"


def test_its_checkpoint_is_of_no_other_task(trained, tmp_path):
    name, _, folder, _ = trained
    words = [f"checkpoint={folder}", "task=StackCube", "device=cpu", f"results_dir={tmp_path}"]
    with pytest.raises(PolicyError, match=f"'{name}' learned the task PickCube, not StackCube"):
        evaluate(compose("evaluate", words))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("words", SHOWN, ids=" ".join)
def test_the_commands_of_the_docs_are_commands(words):
    command, *keys = words
    assert compose(command, keys) is not None


@pytest.mark.parametrize(
    ("name", "key", "message"),
    [
        ("tdmpc2", "policy.model_size=6", "model_size.*6"),
        ("tdmpc2", "policy.horizn=3", "Did you mean 'policy.horizon'"),
        ("fasttd3", "policy.num_steps=0", "policy.num_steps must be above 0, given 0"),
        ("fasttd3", "policy.batch_size=many", "batch_size"),
    ],
)
def test_words_that_cannot_be_are_errors(name, key, message):
    with pytest.raises(RoboVerseError, match=message):
        compose("train", [f"policy={name}", "task=PickCube", key])


def test_a_buffer_that_is_too_small_is_an_error(tmp_path):
    words = [
        "policy=fasttd3",
        "task=control/cartpole",
        "simulator=mujoco",
        "policy.num_envs=4",
        "buffer_size=4",
    ]
    with pytest.raises(ConfigError, match=r"policy.buffer_size=4 holds 1 step.*Take 8 at least"):
        learner_of(compose("train", words), "cpu").learn(tmp_path, None, 0, Reporter())


@pytest.mark.slow
def test_a_run_that_is_complete_is_not_run_again(trained):
    _, config, folder, _ = trained
    rows = read_metrics(folder)
    again = learner_of(config, "cpu").learn(folder, None, 3, Reporter())
    assert (again.steps, again.loss) == (24, None)
    assert read_metrics(folder) == rows


@pytest.mark.slow
def test_the_runner_evaluates_it(trained):
    name, _, folder, _ = trained
    policy = policies.load(folder)
    env = envs.make_vec("PickCube", 2, simulator="mujoco", observation="full", actions="rl", num_threads=1)
    env.max_episode_steps = 3
    try:
        episodes = env.split_indices[:2].tolist()
        records = evaluate_cell(policy, env, episodes, split="train", level=0, seed=0, policy_name=name)
    finally:
        env.close()
    assert [record.length for record in records] == [3, 3]
    assert all(np.isfinite(record.episode_return) for record in records)
