"""TD-MPC2 of several tasks: from the words of the command line to a result of each task."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from benchmark.results import read_result
from envs.core.errors import CheckpointError, ConfigError, PolicyError, RoboVerseError, UnknownNameError
from envs.multi_task_env import MultiTaskEnv
from envs.spec import EnvSpec
from envs.tasks.control.ant import Ant
from envs.tasks.control.cartpole import Cartpole
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.policy import TaskSizes, Tdmpc2Policy
from roboverse_learn import cli
from roboverse_learn.commands.run_folder import read_config
from roboverse_learn.commands.run_identity import identity, run_name
from roboverse_learn.commands.tested_checkpoint import checkpoints_to_test
from roboverse_learn.config.compose import compose
from roboverse_learn.data.sources.policy import PolicyEpisodes, find_demonstrator
from roboverse_learn.train import train as train_command
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.rl import loop as rl_loop
from roboverse_learn.training.rl.environment import make_multi_task_env
from roboverse_learn.training.rl.loop import OBSERVATION
from roboverse_learn.training.rl.tdmpc2 import Tdmpc2Algorithm, Tdmpc2Learner
from tests.roboverse_learn.training.point_mass import (
    GOOD_RETURN,
    RANDOM_RETURN,
    STEPS,
    Mirrored,
    PointMass,
)

TINY = Tdmpc2Config(
    tasks=("mirror",), model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, num_bins=21, simnorm_dim=4,
    num_samples=16, num_elites=4, num_pi_trajs=4, iterations=2, num_envs=8, batch_size=16, seed_steps=200,
    update_ratio=0.0625, buffer_size=20_000, task_dim=8,
)  # fmt: skip
LEARNING = replace(
    TINY, enc_dim=32, mlp_dim=64, latent_dim=32, num_bins=51, num_samples=48, num_elites=8, num_pi_trajs=8,
    iterations=3, batch_size=64, lr=1e-3, update_ratio=0.5,
)  # fmt: skip
SIZES = {"line": TaskSizes(2, 1, STEPS), "mirror": TaskSizes(3, 2, STEPS)}

FIRST, SECOND = "control/cartpole", "control/ant"
WORDS = (
    "policy=tdmpc2", f"task={FIRST}", f"policy.tasks=[{SECOND}]", "simulator=mujoco", "policy.num_envs=3",
    "policy.batch_size=8", "model_size=1", "enc_dim=16", "mlp_dim=16", "latent_dim=16", "num_samples=16",
    "num_elites=4", "num_pi_trajs=4", "iterations=2", "seed_steps=12", "buffer_size=400", "train.steps=48",
    "save_every=24", "log_every=24", "train.num_threads=1", "device=cpu", "slow_ok=true", "splits=[test]",
    "levels=[0]", "episodes=2", "evaluate.num_envs=2", "videos=0",
)  # fmt: skip


def make_algorithm(config=TINY, seed=0):
    env = MultiTaskEnv({"line": PointMass(config.num_envs // 2), "mirror": Mirrored(config.num_envs // 2)})
    policy = Tdmpc2Policy.create(config, {OBSERVATION: 3}, 2, STEPS, seed=seed, several=SIZES)
    return Tdmpc2Algorithm(policy, config.num_envs, STEPS, env.task_ids), env


def train(run_dir, *, steps, config=TINY, **options):
    algorithm, env = make_algorithm(config)
    options = {"log_every": 80, "save_every": 240, "num_threads": 1} | options
    rl_loop.run(algorithm, env, TrainConfig(steps=steps, **options), run_dir)
    return algorithm.policy


# --- learning -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_run_resumes_to_the_same_weights_and_logs_each_task(tmp_path):
    whole = train(tmp_path / "whole", steps=480).state_dict()
    train(tmp_path / "cut", steps=240)
    resumed = train(tmp_path / "cut", steps=480).state_dict()
    assert all(resumed[key].equal(value) for key, value in whole.items())
    rows = read_metrics(tmp_path / "cut")
    assert [row["step"] for row in rows] == [80, 160, 240, 320, 400, 480]
    logged = [row for row in rows if "episode_return" in row]
    tasks = [
        [row[f"episode_return/{task}"] for task in SIZES if f"episode_return/{task}" in row] for row in logged
    ]
    assert {len(returns) for returns in tasks} >= {2}
    for row, returns in zip(logged, tasks, strict=True):
        assert min(returns) - 1e-6 <= row["episode_return"] <= max(returns) + 1e-6


@pytest.mark.slow
def test_run_interrupted_between_checkpoints_resumes(tmp_path):
    train(tmp_path, steps=300)
    assert Tdmpc2Policy.load(tmp_path).tasks == ("line", "mirror")
    train(tmp_path, steps=320)
    assert read_metrics(tmp_path)[-1]["step"] == 320


def test_random_actions_are_zero_in_padding():
    algorithm, env = make_algorithm()
    loop = rl_loop.Loop(algorithm, env, TrainConfig(steps=320), None, 0, rl_loop.Reporter())
    loop.begin(None)
    for _ in range(30):  # 25 times at random
        loop.advance()
    assert algorithm.learning
    stored = algorithm.buffer.storage["action"][:30]
    assert not stored[:, :4, 1].any() and stored[:, 4:].all() and stored[:, :, 0].all()
    drawn = algorithm._drawn()
    seen = drawn.observations[1:, :, 2].amax(0) > 0  # time, of which the first task sees nothing
    assert drawn.task.bool().equal(seen) and 0 < int(drawn.task.sum()) < TINY.batch_size


@pytest.mark.slow
def test_padding_does_not_influence_learning(tmp_path):
    """Padding entries of actions are noise here, and nothing changes."""

    class Deaf(PointMass):
        action_size = 2

        def step(self, actions):
            return super().step(actions + torch.tensor([0.0, torch.inf]))

    learned = []
    for line in (PointMass(4), Deaf(4)):
        algorithm, env = make_algorithm()
        env.envs["line"] = line
        rl_loop.run(algorithm, env, TrainConfig(steps=240, num_threads=1), tmp_path / type(line).__name__)
        learned.append(algorithm.policy.state_dict())
    assert all(learned[0][key].equal(value) for key, value in learned[1].items())


@pytest.mark.long
def test_it_learns_two_opposite_tasks(tmp_path):
    policy = train(tmp_path, steps=2000, config=LEARNING, log_every=200, save_every=20_000)
    rows = [row for row in read_metrics(tmp_path) if "episode_return" in row]
    for task, env in (("line", PointMass(16, seed=5)), ("mirror", Mirrored(16, seed=5))):
        assert rows[0][f"episode_return/{task}"] < RANDOM_RETURN + 4.0, "four episodes at random"
        assert rows[-1][f"episode_return/{task}"] > GOOD_RETURN
        policy.task = task
        observation = env.reset()
        for _ in range(STEPS):
            generators = [torch.Generator().manual_seed(i) for i in range(16)]
            actions = policy.act({OBSERVATION: observation.numpy()}, generators)
            observation = env.step(torch.tensor(actions[:, 0])).obs
        assert env.pop_statistics().episode_return > GOOD_RETURN


# --- the command --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Returns a folder with a run of two tasks, and what the command said."""
    folder = tmp_path_factory.mktemp("several")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cartpole, "max_episode_steps", 3)
        patch.setattr(Ant, "max_episode_steps", 4)
        folders = [f"runs_dir={folder}/runs", f"results_dir={folder}/results"]
        train_command(compose("train", [*WORDS, *folders]))
    return folder


def run_of(folder):
    return next((folder / "runs" / FIRST / "tdmpc2").iterdir())


@pytest.mark.slow
def test_result_of_every_task_names_the_other_tasks(trained):
    run = run_of(trained)
    for task, length in ((FIRST, 3), (SECOND, 4)):
        result = read_result(trained / "results/v2" / task / "tdmpc2" / f"{run.name}.json")
        assert result.train_tasks == (FIRST, SECOND)
        assert [record.length for record in result.records] == [length] * 2
    board = json.loads((trained / "results/leaderboard.json").read_text())
    labels = {section["task"]: [row["label"] for row in section["rows"]] for section in board["sections"]}
    assert labels == {FIRST: [f"tdmpc2, learned with {SECOND}"], SECOND: [f"tdmpc2, learned with {FIRST}"]}
    facts = json.loads((run / "manifest.json").read_text())["stages"]["evaluate"]
    assert [path.split("results/")[1] for path in facts["results"]] == [
        f"v2/{task}/tdmpc2/{run.name}.json" for task in (FIRST, SECOND)
    ]


def test_the_learning_curve_beside_a_result_is_that_of_its_task(trained):
    run = run_of(trained)
    row = [row for row in read_metrics(run) if f"episode_return/{SECOND}" in row][-1]
    assert row[f"episode_return/{FIRST}"] != row[f"episode_return/{SECOND}"]
    for task in (FIRST, SECOND):
        curve = (trained / "results/v2" / task / "tdmpc2" / run.name / "curve.csv").read_text()
        last = dict(zip(*(line.split(",") for line in curve.split()[:: len(curve.split()) - 1]), strict=True))
        assert float(last["episode_return"]) == pytest.approx(row[f"episode_return/{task}"])


def test_evaluation_covers_every_task_or_those_that_are_named(trained, tmp_path):
    run, words = run_of(trained), ["splits=[test]", "levels=[0]", "episodes=2", "device=cpu"]
    both = checkpoints_to_test(compose("evaluate", [f"checkpoint={run}", *words]))
    assert [(each.env.task, each.run) for each in both] == [(FIRST, run.name), (SECOND, run.name)]
    (one,) = checkpoints_to_test(compose("evaluate", [f"checkpoint={run}", f"task={SECOND}", *words]))
    assert (one.env.task, one.run, one.training.tasks) == (SECOND, run.name, (FIRST, SECOND))
    named = checkpoints_to_test(
        compose("evaluate", [f"checkpoint={run}", f"task=[{SECOND},{FIRST}]", *words])
    )
    assert [each.env.task for each in named] == [SECOND, FIRST]
    alone = tmp_path / "model"  # outside a run: the checkpoint itself has its tasks
    (run / "checkpoints/last/pretrained_model").resolve().rename(alone)
    try:
        found = checkpoints_to_test(compose("evaluate", [f"checkpoint={alone}", *words]))
        assert [(each.env.task, each.training.tasks) for each in found] == [
            (task, (FIRST, SECOND)) for task in (FIRST, SECOND)
        ]
    finally:
        alone.rename((run / "checkpoints/last").resolve() / "pretrained_model")


def test_no_other_task_is_evaluated_or_demonstrated(trained, capsys):
    run = run_of(trained)
    words = [f"checkpoint={run}", "task=control/franka_reach", f"results_dir={trained}/none"]
    assert cli.main(["evaluate", *words]) == 2
    logged = capsys.readouterr().err
    assert f"learned the tasks {FIRST} and {SECOND}, not control/franka_reach. Give" in logged
    with pytest.raises(PolicyError, match=f"Give task={FIRST} or task={SECOND}, or train it on PickCube"):
        find_demonstrator(str(run), "PickCube")


def test_each_of_its_tasks_can_be_demonstrated(trained):
    run = run_of(trained)
    words = ["source=policy", f"checkpoint={run}"]
    assert compose("collect", words).env.task == FIRST
    demonstrator = find_demonstrator(str(run), SECOND)
    source = PolicyEpisodes(
        checkpoint=str(demonstrator.checkpoint),
        identity=demonstrator.identity(),
        device="cpu",
        env=EnvSpec(task=SECOND, image_size=32).to_json(),
        num_envs=1,
    )
    try:
        source._env.reset_envs(np.arange(1), [0])
        state = source._env.handler.get_states()
        (actions,) = source._planner.plan_batch(state, [np.random.default_rng(0)])
        assert actions.shape == (1, len(Ant().controller.names))
    finally:
        source.close()
    trained_with = read_config(run)
    for task in (FIRST, SECOND):
        assert trained_with.learned_hz(task) == EnvSpec(task=task).control_hz


def test_environments_are_divided_among_the_tasks():
    config = compose("train", [*WORDS, "policy.num_envs=5"])
    env = make_multi_task_env(config, 5, 0, "cpu")
    try:
        assert {task: each.num_envs for task, each in env.envs.items()} == {FIRST: 3, SECOND: 2}
        assert env.reset().shape == (5, max(each.observation_size for each in env.envs.values()))
    finally:
        env.close()
    timed = Tdmpc2Learner.brief(Tdmpc2Config(tasks=tuple("abcdefghij"), num_envs=64))
    assert timed.num_envs == 11  # one each, though eight would do for one task


def test_one_task_keeps_the_name_of_its_run():
    alone = compose("train", ["policy=tdmpc2", f"task={FIRST}"])
    assert "policy.tasks" not in identity(alone)
    together = compose("train", ["policy=tdmpc2", f"task={FIRST}", f"tasks={SECOND}"])
    assert together.tasks == (FIRST, SECOND) and run_name(together) != run_name(alone)


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (["policy.tasks=[control/an]"], UnknownNameError, r"task 'control/an'. Did you mean 'control/ant'"),
        (
            [f"policy.tasks=[{SECOND},{FIRST}]"],
            ConfigError,
            rf"'{FIRST}' is learned twice: task={FIRST}, and policy\.tasks=\[{SECOND},{FIRST}\]\.",
        ),
        (["policy.num_envs=1"], RoboVerseError, r"num_envs=1 is less than one environment for each of the 2"),
        (["policy.observation=pixels"], RoboVerseError, r"together from states.*without policy.tasks"),
        (["scenario.physics.decimation=5"], ConfigError, r"scenario.\* change one task, and 2 are learned"),
        (["policy=fasttd3"], UnknownNameError, r"'policy.tasks' of train. It is a key of .*policy=tdmpc2"),
    ],
)  # fmt: skip
def test_tasks_that_cannot_be_learned_together_are_errors(words, error, said):
    with pytest.raises((error, PolicyError), match=said):
        compose("train", [*(word for word in WORDS if "num_envs" not in word), *words])


def test_further_task_without_reward_is_refused_before_the_run(monkeypatch, tmp_path):
    monkeypatch.setattr(Ant, "has_reward", False)
    config = compose("train", [*WORDS, f"runs_dir={tmp_path}"])
    with pytest.raises(ConfigError, match=f"Task '{SECOND}' has no reward, which policy=tdmpc2 learns from"):
        learner_of(config, "cpu").check()


def test_run_of_other_tasks_is_not_resumed(trained, tmp_path):
    run = run_of(trained)
    words = ["train", f"run={run}", "policy=tdmpc2"]
    with pytest.raises(ConfigError, match=rf"you gave policy.tasks=.*franka_reach.*, it has \['{SECOND}'\]"):
        train_command(compose("train", [*words[1:], "policy.tasks=[control/franka_reach]"]))
    assert policies.load(run).tasks == (FIRST, SECOND)
    with pytest.raises(CheckpointError, match=rf"tasks was \['{FIRST}', '{SECOND}'\] and is \['line'"):
        algorithm, env = make_algorithm()
        algorithm.policy.task = FIRST
        rl_loop.run(algorithm, env, TrainConfig(steps=48, num_threads=1), run)
