"""The learner of TD-MPC2: it learns, resumes after it is killed, and stops when it diverges."""

import json
from dataclasses import replace

import pytest
import torch

from envs.core.errors import CheckpointError, ConfigError
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import plan
from policies.tdmpc2.policy import Tdmpc2Policy
from roboverse_learn.config.compose import compose
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.divergence import TrainingDivergedError
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl import loop as rl_loop
from roboverse_learn.training.rl.loop import OBSERVATION
from roboverse_learn.training.rl.tdmpc2 import Tdmpc2Algorithm
from tests.roboverse_learn.training.point_mass import GOOD_RETURN, RANDOM_RETURN, STEPS, PointMass
from tests.roboverse_learn.training.signals import SignalAt

pytestmark = pytest.mark.slow

TINY = Tdmpc2Config(
    model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, num_bins=21, simnorm_dim=4, num_samples=16,
    num_elites=4, num_pi_trajs=4, iterations=2, num_envs=8, batch_size=16, seed_steps=200, update_ratio=0.125,
    buffer_size=20_000,
)  # fmt: skip
LEARNING = replace(
    TINY, enc_dim=32, mlp_dim=64, latent_dim=32, num_bins=51, num_samples=48, num_elites=8, num_pi_trajs=8,
    iterations=3, batch_size=64, lr=1e-3, update_ratio=0.5,
)  # fmt: skip


def train(run_dir, *, steps=320, config=TINY, env=None, seed=0, resume=True, reporter=None, **options):
    env = PointMass(config.num_envs) if env is None else env
    policy = Tdmpc2Policy.create(config, {OBSERVATION: 2}, 1, STEPS, seed=seed)
    algorithm = Tdmpc2Algorithm(policy, config.num_envs, STEPS)
    options = {"log_every": 80, "save_every": 240, "num_threads": 1} | options
    settings = TrainConfig(steps=steps, **options)
    result = rl_loop.run(algorithm, env, settings, run_dir, seed=seed, resume=resume, reporter=reporter)
    return result, policy


@pytest.mark.long
def test_it_learns(tmp_path):
    result, policy = train(tmp_path, steps=2400, config=LEARNING, log_every=200, save_every=4000)
    rows = [row for row in read_metrics(tmp_path) if "episode_return" in row]
    assert rows[0]["episode_return"] < RANDOM_RETURN + 2.0, "before the first update"
    assert rows[-1]["episode_return"] > GOOD_RETURN
    assert result.steps == 2400 and result.stopped_by == "steps"
    env = PointMass(16, seed=5)
    observation = env.reset()
    for _ in range(STEPS):
        actions = policy.act({OBSERVATION: observation.numpy()}, generators(16))
        observation = env.step(torch.tensor(actions[:, 0])).obs
    assert env.pop_statistics().episode_return > GOOD_RETURN


def test_a_small_preset_plans_as_exactly_as_it_explores():
    """With the reward 1 - (action - 0.3)², the best action is 0.3."""
    config = compose("train", ["policy=tdmpc2", "preset=quick"]).policy
    best, envs = 0.3, 200

    class Known:
        def next(self, z, action, task=None):
            return z

        def reward(self, z, action, task=None):
            return 1.0 - (action[..., 0] - best).square()

        def ended(self, z, task=None):
            return torch.zeros_like(z[..., 0])

        def prior(self, z, noise, task=None):
            return torch.tanh(noise), torch.zeros_like(noise), noise

        def values(self, z, action, task=None, *, members=None):
            return torch.zeros_like(z[..., 0])

        def action_mask(self, task):
            return None

    generator = torch.Generator().manual_seed(0)
    start = torch.zeros(envs, config.horizon, 1)
    planned = plan(
        config, Known(), torch.zeros(envs, 1), start, 0.98, lambda *n: torch.randn(*n, generator=generator)
    )
    assert (planned.action - best).square().mean().sqrt() < config.min_std


def generators(num):
    return [torch.Generator().manual_seed(i) for i in range(num)]


def test_a_run_leaves_what_every_run_leaves(tmp_path):
    steps = []

    class Listener(Reporter):
        def on_checkpoint(self, step, directory):
            steps.append(step)

    env = PointMass(TINY.num_envs)
    policy = Tdmpc2Policy.create(TINY, {OBSERVATION: 2}, 1, STEPS)
    algorithm = Tdmpc2Algorithm(policy, TINY.num_envs, STEPS)
    config = TrainConfig(steps=320, log_every=80, save_every=240, num_threads=1)
    result = rl_loop.run(algorithm, env, config, tmp_path, reporter=Listener())
    assert steps == [240, 320]
    assert Tdmpc2Policy.load(tmp_path).discount == policy.discount
    rows = read_metrics(tmp_path)
    assert [row["step"] for row in rows] == [80, 160, 240, 320]
    assert {"loss", "consistency_loss", "updates", "steps_per_s"} <= rows[-1].keys()
    # 200 steps are seeds, which make 25 updates due; every 8 steps after them one.
    assert "loss" not in rows[1] and rows[-1]["updates"] == 25 + 15
    assert result.plot is not None and result.plot.is_file() and list((tmp_path / "tensorboard").iterdir())
    states = list((tmp_path / "checkpoints").glob("[0-9]*/training_state"))
    assert [path.parent.name for path in states] == ["000320"]


def weights(policy):
    return policy.state_dict()["dynamics.0.weight"]


def test_the_same_seed_learns_the_same_and_another_does_not(tmp_path):
    first, second, other = (train(tmp_path / str(i), seed=i // 2)[1] for i in range(3))
    assert weights(first).equal(weights(second))
    assert not weights(first).equal(weights(other))


def test_run_resumes_to_the_same_weights(tmp_path):
    _, whole = train(tmp_path / "whole", steps=480)
    train(tmp_path / "cut", steps=240)
    _, resumed = train(tmp_path / "cut", steps=480)
    assert weights(whole).equal(weights(resumed))
    steps = [row["step"] for row in read_metrics(tmp_path / "cut")]
    assert steps == [row["step"] for row in read_metrics(tmp_path / "whole")]


def saved(run_dir):
    return json.loads((run_dir / "checkpoints/last/training_state/state.json").read_text())["numbers"]


def test_run_without_saved_replay_refills_it(tmp_path):
    config = replace(TINY, save_replay=False)
    train(tmp_path, steps=240, config=config)
    updates = saved(tmp_path)["updates"]
    train(tmp_path, steps=480, config=config)
    assert saved(tmp_path)["updates"] == updates + 6  # 200 of the 240 steps fill it


class Clock(Reporter):
    """A second passes at every call of the reporter."""

    def __init__(self, monkeypatch):
        self.now, self.steps = 0.0, []
        monkeypatch.setattr(rl_loop.time, "perf_counter", lambda: self.now)

    def on_start(self, progress, policy):
        self.now += 1.0

    def on_step(self, progress):
        self.now += 1.0
        self.steps.append(progress.step)


# What is logged and saved at step 200 has all its updates.
@pytest.mark.parametrize("every", [pytest.param(240, marks=pytest.mark.long), 200])
def test_run_stopped_among_its_first_updates_resumes_identically(every, tmp_path, monkeypatch):
    options = {"steps": 400, "log_every": every, "save_every": every}
    clock = Clock(monkeypatch)
    _, whole = train(tmp_path / "whole", reporter=clock, **options)
    assert clock.steps.count(192) == 1 and clock.steps.count(200) == 25
    for limit, updates in ((30.0, 5), (40.0, 14)):
        result, _ = train(tmp_path / "cut", reporter=clock, time_limit_s=limit, **options)
        assert result.stopped_by == "time_limit" and result.steps == 200
        numbers = saved(tmp_path / "cut")
        assert numbers["updates"] == updates and numbers["algorithm"]["due"] == 25 - updates
    assert Tdmpc2Policy.load(tmp_path / "cut")
    _, resumed = train(tmp_path / "cut", reporter=clock, **options)
    assert all(value.equal(resumed.state_dict()[key]) for key, value in whole.state_dict().items())
    last, same = read_metrics(tmp_path / "cut")[-1], read_metrics(tmp_path / "whole")[-1]
    assert last["updates"] == same["updates"] == 50 and last["loss"] == same["loss"]


def test_pending_updates_run_before_a_run_is_complete(tmp_path, monkeypatch):
    _, whole = train(tmp_path / "whole", steps=200)
    clock = Clock(monkeypatch)
    result, _ = train(tmp_path / "cut", steps=200, reporter=clock, time_limit_s=30.0)
    assert result.stopped_by == "time_limit" and saved(tmp_path / "cut")["updates"] == 5
    result, resumed = train(tmp_path / "cut", steps=200, reporter=clock)
    assert result.stopped_by == "steps" and saved(tmp_path / "cut")["updates"] == 25
    assert weights(whole).equal(weights(resumed))


def test_signal_is_handled_between_two_updates(tmp_path):
    _, whole = train(tmp_path / "whole")
    reporter = SignalAt(200)
    with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        train(tmp_path / "cut", reporter=reporter)
    assert reporter.checkpoints == [200] and saved(tmp_path / "cut")["updates"] == 1
    _, resumed = train(tmp_path / "cut")
    assert weights(whole).equal(weights(resumed))


def test_pending_updates_run_once_the_replay_is_refilled(tmp_path, monkeypatch):
    config = replace(TINY, save_replay=False)
    clock = Clock(monkeypatch)
    train(tmp_path, config=config, reporter=clock, time_limit_s=30.0)
    for steps, updates, due in ((392, 5, 20), (600, 5 + 20 + 2, 0)):  # 192 steps do not fill it; 208 do
        train(tmp_path, steps=steps, config=config, reporter=clock)
        numbers = saved(tmp_path)
        assert numbers["updates"] == updates and numbers["algorithm"]["due"] == due


def test_a_run_of_another_configuration_is_not_gone_on_with(tmp_path):
    train(tmp_path, steps=240)
    with pytest.raises(CheckpointError, match=r"Cannot resume from .*: seed was 0 and is 1"):
        train(tmp_path, steps=480, seed=1)
    (tmp_path / "checkpoints/last/training_state/state.json").write_text("{")
    with pytest.raises(CheckpointError, match="cannot be read"):
        train(tmp_path, steps=480)


class Broken(PointMass):
    """Its rewards are no numbers from step 35 on."""

    def step(self, actions):
        self.count = getattr(self, "count", 0) + 1
        step = super().step(actions)
        return step._replace(reward=step.reward * (float("nan") if self.count > 35 else 1.0))


def test_a_diverged_run_stops_at_once_and_keeps_its_last_checkpoint(tmp_path):
    config = replace(TINY, update_ratio=1.0)
    message = (
        r"'\w+' is nan at environment step 28\d.*last checkpoint.*is sound"  # not at the next logged one
    )
    with pytest.raises(TrainingDivergedError, match=message):
        train(tmp_path, steps=4000, env=Broken(TINY.num_envs), config=config)
    assert weights(Tdmpc2Policy.load(tmp_path)).isfinite().all()
    assert [path.name for path in (tmp_path / "checkpoints").glob("[0-9]*")] == ["000240"]


def test_divergence_before_the_first_checkpoint_says_there_is_none(tmp_path):
    message = r"is nan at environment step 28\d.* No checkpoint had been saved; a smaller train.save_every"
    with pytest.raises(TrainingDivergedError, match=message):
        train(
            tmp_path,
            steps=4000,
            save_every=4000,
            env=Broken(TINY.num_envs),
            config=replace(TINY, update_ratio=1.0),
        )


def test_a_time_limit_ends_a_run(tmp_path):
    result, _ = train(tmp_path, steps=10**9, time_limit_s=0.5)
    assert result.stopped_by == "time_limit" and result.steps < 10**6
    assert Tdmpc2Policy.load(tmp_path)


def test_a_buffer_that_never_holds_the_seed_steps_is_an_error(tmp_path):
    message = r"buffer_size=190 holds 184 steps, and learning begins after 200. Take policy.buffer_size=200"
    with pytest.raises(ConfigError, match=f"{message} at least, or a smaller policy.seed_steps"):
        train(tmp_path, config=replace(TINY, buffer_size=190))
