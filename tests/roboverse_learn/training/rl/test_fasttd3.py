"""The learner of FastTD3: it learns, is repeatable, and resumes after it is killed."""

import json
from dataclasses import replace

import pytest

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from policies.fasttd3.config import FastTd3Config
from policies.fasttd3.policy import FastTd3Policy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.rl import loop as rl_loop
from roboverse_learn.training.rl.fasttd3 import FastTd3Algorithm
from roboverse_learn.training.rl.loop import OBSERVATION
from tests.roboverse_learn.training.point_mass import GOOD_RETURN, STEPS, PointMass
from tests.roboverse_learn.training.signals import SignalAt

pytestmark = pytest.mark.slow

TINY = FastTd3Config(
    actor_dim=32, critic_dim=64, v_min=0.0, v_max=25.0, num_atoms=51, lr=1e-3, weight_decay=0.0, std_max=0.8,
    std_min=0.05, num_envs=16, batch_size=256, buffer_size=32_000, save_replay=True,
)  # fmt: skip


def train(run_dir, *, steps=640, config=TINY, seed=0, env=None, reporter=None, **options):
    env = env or PointMass(config.num_envs)
    policy = FastTd3Policy.create(config, {OBSERVATION: env.observation_size}, env.action_size, seed=seed)
    options = {"log_every": 160, "save_every": 320, "num_threads": 1} | options
    settings = TrainConfig(steps=steps, **options)
    algorithm = FastTd3Algorithm(policy, config.num_envs)
    return rl_loop.run(algorithm, env, settings, run_dir, seed=seed, reporter=reporter), policy


def test_it_learns(tmp_path):
    train(tmp_path, steps=6400, log_every=1600, save_every=16_000)
    rows = read_metrics(tmp_path)
    assert rows[0]["episode_return"] < 12.0
    policy = FastTd3Policy.load(tmp_path)
    env = PointMass(32, seed=5)
    observation = env.reset()
    for _ in range(STEPS):
        observation = env.step(policy.actor(policy.norm(observation))).obs
    assert env.pop_statistics().episode_return > GOOD_RETURN


def weights(policy):
    return policy.state_dict()["actor.layers.0.weight"]


def test_the_same_seed_learns_the_same_and_another_does_not(tmp_path):
    first, second, other = (train(tmp_path / str(i), seed=i // 2)[1] for i in range(3))
    assert weights(first).equal(weights(second))
    assert not weights(first).equal(weights(other))


def state_file(run_dir):
    return run_dir / "checkpoints/last/training_state/state.json"


def test_run_resumes_to_the_same_weights(tmp_path):
    _, whole = train(tmp_path / "whole")
    train(tmp_path / "cut", steps=320)
    _, resumed = train(tmp_path / "cut")
    assert weights(whole).equal(weights(resumed))


def test_old_checkpoint_has_no_pending_updates(tmp_path):
    train(tmp_path, steps=320)
    state = json.loads(state_file(tmp_path).read_text())
    assert state["numbers"]["algorithm"].pop("due") == 0
    state_file(tmp_path).write_text(json.dumps(state))
    train(tmp_path)
    assert read_metrics(tmp_path)[-1]["updates"] == 2 * (40 - 10 + 1)


def cartpole():
    spec = EnvSpec(task="control/cartpole")
    return spec.make_torch(TINY.num_envs, max_episode_steps=15, bank_size=8, num_threads=1)


@pytest.mark.parametrize(
    "make_env", [lambda: PointMass(TINY.num_envs), pytest.param(cartpole, marks=pytest.mark.long)]
)
def test_signal_saves_a_checkpoint_that_resumes_identically(make_env, tmp_path):
    _, whole = train(tmp_path / "whole", env=make_env())
    reporter = SignalAt(31 * 16)
    with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        train(tmp_path / "cut", env=make_env(), reporter=reporter)
    assert reporter.checkpoints == [320, 496]
    state = json.loads(state_file(tmp_path / "cut").read_text())
    assert state["numbers"]["algorithm"]["due"] == 1, "the second update of the step"
    _, resumed = train(tmp_path / "cut", env=make_env())
    assert weights(whole).equal(weights(resumed))


def test_without_its_replay_a_run_gathers_a_batch_first(tmp_path):
    config = replace(TINY, save_replay=False)
    train(tmp_path, steps=320, config=config)
    before = read_metrics(tmp_path)[-1]["updates"]
    train(tmp_path, config=config)
    assert read_metrics(tmp_path)[-1]["updates"] == before + 2 * 5  # 15 of 20 steps make a batch of 256


@pytest.mark.parametrize("num_updates", [1, 3])
def test_the_number_of_updates_follows_the_steps(num_updates, tmp_path):
    train(tmp_path, steps=320, config=replace(TINY, num_updates=num_updates))
    assert read_metrics(tmp_path)[-1]["updates"] == num_updates * (20 - 10 + 1)


def test_without_its_replay_a_batch_is_gathered_of_a_buffer_that_hardly_holds_more(tmp_path):
    config = replace(TINY, save_replay=False, buffer_size=512)
    train(tmp_path, steps=320, config=config)
    before = read_metrics(tmp_path)[-1]["updates"]
    train(tmp_path, config=config)
    assert read_metrics(tmp_path)[-1]["updates"] == before + 2 * 5  # 15 of 20 steps make a batch of 256


def test_a_buffer_that_never_holds_the_steps_before_learning_is_an_error(tmp_path):
    message = r"buffer_size=150 holds 144 steps, and learning begins after 160. Take policy.buffer_size=160"
    with pytest.raises(ConfigError, match=message):
        train(tmp_path, config=replace(TINY, buffer_size=150))
