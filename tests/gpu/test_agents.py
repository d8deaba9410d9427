"""Agents on a GPU: compiled and recorded updates, runs that are resumed, and the CPU's first updates."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from policies.fasttd3.policy import FastTd3Policy
from policies.fasttd3.update import Updater as FastTd3Updater
from policies.tdmpc2.agent import Tdmpc2Agent
from policies.tdmpc2.policy import Tdmpc2Policy
from policies.tdmpc2.update import Updater as Tdmpc2Updater
from roboverse_learn.config.compose import compose
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from roboverse_learn.training.rl.loop import Loop
from tests.gpu.draws import DrawnOnTheCpu
from tests.gpu.marks import COMPILES
from tests.policies.test_agents_compiled import FASTTD3, SIZES, TDMPC2, sequences

pytestmark = COMPILES

CALLS = 12
"""The first are run as they are, then two graphs are recorded, and the rest are played back."""

STOP, END = 1024, 2048
"""Environment steps, whole rollouts of PPO."""

WORDS = {
    "fasttd3": ("policy.num_envs=64", "policy.batch_size=256", "actor_dim=32", "critic_dim=32",
                "buffer_size=64000", "save_replay=true"),
    "ppo": ("policy.num_envs=64", "policy.num_steps=8", "policy.num_minibatches=4", "hidden_dims=[32]"),
    "tdmpc2": ("policy.num_envs=16", "policy.batch_size=32", "model_size=1", "num_samples=64", "num_elites=8",
               "num_pi_trajs=8", "iterations=2", "seed_steps=320", "buffer_size=8000", "update_ratio=0.125"),
}  # fmt: skip
WORDS["tdmpc2 of two tasks"] = (*WORDS["tdmpc2"], "policy.tasks=[PickCube]")
OF_IMAGES = ("policy.observation=pixels", "cameras=[front,rail]", "image_size=64")
WORDS["tdmpc2 of images"] = (*WORDS["tdmpc2"], *OF_IMAGES)
WORDS["ppo of images"] = (*WORDS["ppo"], *OF_IMAGES)

TWO_UPDATES = {
    "fasttd3": ("policy.num_envs=8", "policy.batch_size=32", "actor_dim=32", "critic_dim=32",
                "buffer_size=6400", "learning_starts=4", "num_updates=2", "bf16=false"),
    "ppo": ("policy.num_envs=8", "policy.num_steps=4", "num_epochs=2", "num_minibatches=1",
            "hidden_dims=[32]"),
    "tdmpc2": ("policy.num_envs=8", "policy.batch_size=16", "model_size=1", "seed_steps=64",
               "buffer_size=8000", "update_ratio=0.03125", "policy.dropout=0.0"),
}  # fmt: skip
"""After the first steps, before what was learned decides on an action."""


def on_gpu(given):
    return type(given)(*(None if field is None else field.cuda() for field in given))


def configured(name, *words):
    words = (f"policy={name.partition(' ')[0]}", "task=control/cartpole", *words)
    return compose("train", list(words))


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=pytest.mark.long)])
def test_plans_that_are_played_back_depend_on_what_is_seen(fast):
    policy = Tdmpc2Policy.create(TDMPC2, SIZES, 2, 100, "cuda")
    for weights in policy.model.parameters():
        if weights.ndim > 1:  # A new network's value is 0 whatever is seen, and so all plans are as good.
            torch.nn.init.normal_(weights, std=0.5)
    agent = Tdmpc2Agent(TDMPC2, policy.model, 0.9, 4, compile=fast, cuda_graphs=True)
    seen, anew = torch.randn(2, 4, 5, device="cuda"), torch.ones(4, dtype=torch.bool, device="cuda")

    def act(observation):
        torch.manual_seed(0)
        return agent.act(observation, anew).clone()

    actions = [act(seen[call % 2]) for call in range(CALLS)]
    played_back = actions[-4:]
    assert all(action.abs().max() <= 1.0 for action in actions)
    assert (played_back[0] - played_back[2]).abs().max() < 1e-3
    assert (played_back[1] - played_back[3]).abs().max() < 1e-3
    assert (played_back[0] - played_back[1]).abs().max() > 0.05
    agent.act(seen[0], ~anew)
    assert agent.mean.isfinite().all()


def test_updates_of_tdmpc2_that_are_played_back_learn_as_plain_ones_do():
    losses = {}
    for fast in (False, True):
        policy = Tdmpc2Policy.create(replace(TDMPC2, lr=3e-3), SIZES, 2, 100, "cuda")
        updater = Tdmpc2Updater(
            policy.config, policy.model, [policy.discount], compile=fast, cuda_graphs=fast
        )
        given = on_gpu(sequences(8))
        losses[fast] = [float(updater.update(given)["reward_loss"]) for _ in range(CALLS)]
    assert losses[True] == pytest.approx(losses[False], rel=0.05)
    assert losses[True][-1] < losses[True][0]


@pytest.mark.parametrize("bf16", [True, pytest.param(False, marks=pytest.mark.long)])
def test_updates_of_fasttd3_that_are_played_back_learn_as_plain_ones_do(bf16):
    losses = {}
    for fast in (False, True):
        policy = FastTd3Policy.create(FASTTD3, SIZES, 2, "cuda")
        updater = FastTd3Updater(
            FASTTD3, policy.actor, policy.critics, policy.norm, compile=fast, cuda_graphs=fast, bf16=bf16
        )
        given = sequences(8)
        batch = (given.observations[0], given.actions[0], given.rewards[0], given.terminated[0])
        batch = tuple(field.cuda() for field in (*batch, given.observations[1]))
        losses[fast] = [float(updater.update(*batch)["loss"]) for _ in range(CALLS)]
        assert updater.updates == CALLS
    assert losses[True] == pytest.approx(losses[False], rel=0.02)


@pytest.mark.parametrize("name", sorted(WORDS))
@pytest.mark.parametrize("compile", [False, pytest.param(True, marks=pytest.mark.long)])
def test_run_on_a_gpu_resumes_where_it_stopped(name, compile, tmp_path):
    is_ppo = name.startswith("ppo")
    if compile and is_ppo:
        pytest.skip("PPO is not compiled")
    own = () if is_ppo else (f"policy.compile={compile}".lower(),)

    def run(steps):
        config = configured(name, *WORDS[name], *own, f"steps={steps}", "save_every=100000", "log_every=512")
        return learner_of(config, "cuda").learn(tmp_path, None, 0, Reporter())

    assert run(STOP).steps == STOP
    before = read_metrics(tmp_path)[-1]["updates"]
    assert run(END).stopped_by == "steps"
    rows = read_metrics(tmp_path)
    assert rows[-1]["updates"] > before > 0 and rows[-1]["step"] == END
    assert all(row["loss"] == row["loss"] for row in rows if "loss" in row)
    assert any("loss" in row for row in rows)


def first_updates(config, device):
    """Returns the mean terms of the first updates: MuJoCo steps, and the CPU samples the random numbers."""
    learner = learner_of(config, device)
    with closing(learner.open_env(0)) as env, DrawnOnTheCpu():
        torch.manual_seed(0)
        agent = learner.make_agent(env, 0)
        assert agent.policy.device.type == device
        loop = Loop(agent, env, config.train, Path(), 0, Reporter())
        loop.begin(None)
        while not loop.updates:
            loop.advance()
        return {key: float(value) / loop.pending for key, value in loop.sums.items()}


@pytest.mark.parametrize("name", sorted(TWO_UPDATES))
def test_the_first_updates_are_those_of_the_cpu(name):
    own = () if name == "ppo" else ("policy.compile=false", "policy.cuda_graphs=false")
    config = configured(name, *TWO_UPDATES[name], *own, "simulator=mujoco")
    ours, theirs = (first_updates(config, device) for device in ("cuda", "cpu"))
    assert ours == pytest.approx(theirs, rel=2e-2, abs=1e-4)
    assert abs(theirs["loss"]) > 1e-3


@pytest.mark.parametrize("backend", ["rsl_rl", "torchrl"])
def test_images_of_a_rollout_stay_on_the_gpu_as_bytes(backend):
    config = configured("ppo", *WORDS["ppo of images"], f"policy.backend={backend}")
    learner = learner_of(config, "cuda")
    with closing(learner.open_env(0)) as env:
        agent = learner.make_agent(env, 0)
        loop = Loop(agent, env, config.train, Path(), 0, Reporter())
        loop.begin(None)
        assert (loop.observation.dtype, loop.observation.device.type) == (torch.uint8, "cuda")
        before = {key: weight.clone() for key, weight in agent.policy.state_dict().items()}
        while not loop.updates:
            loop.advance()
        if backend == "rsl_rl":
            (kept,) = agent.ppo.storage.observations.values()
            assert (kept.dtype, kept.device.type) == (torch.uint8, "cuda")
        after = agent.policy.state_dict()
        for key in ("norm.images.0.weight", "norm.images.4.weight", "norm.state.weight"):
            assert not after[key].equal(before[key]) and after[key].isfinite().all(), key
