"""One TD-MPC2 of several tasks: padding does not change its actions, and a loaded policy has its tasks."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs.core.errors import PolicyError
from policies.checkpoint import learned_tasks
from policies.tdmpc2 import planner
from policies.tdmpc2.agent import Tdmpc2Agent
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.policy import TaskSizes, Tdmpc2Policy
from policies.tdmpc2.update import Sequences, Updater

KEY = "observation.environment_state"
TASKS = {"family/small": TaskSizes(2, 1, 1000), "large": TaskSizes(4, 3, 100)}
CONFIG = Tdmpc2Config(
    tasks=("large",), model_size=1, enc_dim=16, mlp_dim=16, latent_dim=16, num_bins=21, num_samples=16,
    num_elites=4, num_pi_trajs=2, iterations=2, task_dim=4,
)  # fmt: skip


def make(**changes) -> Tdmpc2Policy:
    policy = Tdmpc2Policy.create(replace(CONFIG, **changes), {KEY: 4}, 3, 1000, several=TASKS)
    torch.nn.init.normal_(policy.model.prior_head[-1].weight)  # so that what is seen changes what is done
    return policy


def act(policy: Tdmpc2Policy, task: str, n: int = 3) -> np.ndarray:
    policy.task = task
    seen = np.random.default_rng(0).normal(size=(n, TASKS[task].observation_size)).astype(np.float32)
    return policy.act({KEY: seen}, [torch.Generator().manual_seed(i) for i in range(n)])


@pytest.mark.parametrize("plan", [True, False])
def test_it_acts_in_each_task_and_alike_when_loaded(plan, tmp_path):
    policy = make(plan=plan)
    assert policy.task == "family/small" and policy.tasks == ("family/small", "large")
    policy.save(tmp_path)
    loaded = Tdmpc2Policy.load(tmp_path)
    assert (loaded.several, loaded.config, loaded.task) == (TASKS, policy.config, "family/small")
    assert learned_tasks(tmp_path) == ("family/small", "large")
    for task, sizes in TASKS.items():
        actions = act(policy, task)
        assert actions.shape == (3, 1, sizes.action_size) and np.abs(actions).max() <= 1.0
        np.testing.assert_array_equal(act(loaded, task), actions)


def test_the_task_decides_what_is_done_and_which_discount_counts():
    policy = Tdmpc2Policy.create(
        CONFIG, {KEY: 2}, 1, 1000, several={"a": TaskSizes(2, 1, 1000), "b": TaskSizes(2, 1, 200)}
    )
    for weight in (policy.model.prior_head[-1].weight, policy.model.task_embedding.weight):
        torch.nn.init.normal_(weight)
    seen, done = {KEY: np.ones((8, 2), np.float32)}, []
    for task, discount in (("a", 0.995), ("b", 0.975)):
        policy.task = task
        done.append(policy.act(seen, [torch.Generator().manual_seed(i) for i in range(8)]))
        assert policy.discount == pytest.approx(discount)
    assert not np.array_equal(*done)
    assert policy.discounts == pytest.approx([0.995, 0.975])


def test_a_task_that_it_has_not_learned_is_an_error():
    policy = make()
    policy.task = "other"
    with pytest.raises(
        PolicyError, match=r"acts in family/small, large, which it learned; its task is 'other'"
    ):
        policy.act({KEY: np.zeros((1, 2), np.float32)})
    policy.task = "large"
    with pytest.raises(PolicyError, match=r"has shape \(1, 2\).*made for \(n, 4\)"):
        policy.act({KEY: np.zeros((1, 2), np.float32)})


def agent_of(policy: Tdmpc2Policy, task: torch.Tensor) -> Tdmpc2Agent:
    discount = torch.tensor(policy.discounts)[task][:, None]
    return Tdmpc2Agent(policy.config, policy.model, discount, len(task), task)


@pytest.mark.parametrize("plan", [True, False])
def test_while_it_explores_entries_that_a_task_lacks_stay_zero(plan):
    policy = make(plan=plan)
    agent = agent_of(policy, torch.tensor([0, 0, 1]))
    for first in (True, False):
        action = agent.act(torch.randn(3, 4), torch.full((3,), first))
        assert not action[:2, 1:].any() and action[2].all() and action[:, 0].all()
        assert not agent.mean[:2, :, 1:].any()


def batch(task: torch.Tensor) -> Sequences:
    generator = torch.Generator().manual_seed(1)
    return Sequences(
        torch.randn(4, 8, 4, generator=generator), torch.rand(3, 8, 3, generator=generator),
        torch.randn(3, 8, generator=generator), torch.zeros(3, 8), torch.ones(3, 8), task,
    )  # fmt: skip


def test_the_prior_learns_nothing_for_entries_that_a_task_lacks():
    policy = make(dropout=0.0)
    updater = Updater(policy.config, policy.model, policy.discounts)
    torch.nn.init.normal_(policy.model.q.weights[-1])
    small = torch.zeros(8, dtype=torch.long)
    loss, _ = updater.prior_loss(torch.rand(4, 8, 16), batch(small))
    loss.backward()
    grad = policy.model.prior_head[-1].weight.grad
    of_mean, of_std = grad.chunk(2)
    assert of_mean[0].any() and of_std[0].any()
    assert not of_mean[1:].any() and not of_std[1:].any()


def test_an_update_leaves_no_gradient_for_the_next_one():
    policy = make()
    updater = Updater(policy.config, policy.model, policy.discounts)
    before = policy.model.task_embedding.weight.clone()
    updater.update(batch(torch.arange(8) % 2))
    assert not policy.model.task_embedding.weight.equal(before)
    assert all(parameter.grad is None for parameter in policy.model.parameters())


@pytest.mark.long
def test_learning_and_the_search_compile_without_a_break():
    policy, options = make(dropout=0.0), {"backend": "eager", "fullgraph": True}
    given = batch(torch.arange(8) % 2)
    updater = Updater(policy.config, policy.model, policy.discounts)
    torch.manual_seed(5)
    expected, zs, _ = updater.world_loss(given)
    torch.manual_seed(5)
    found, _, _ = torch.compile(updater.world_loss, **options)(given)
    torch.testing.assert_close(found, expected)
    torch.compile(updater.prior_loss, **options)(zs, given)
    agent = agent_of(policy, torch.tensor([0, 1]))
    agent._improve = torch.compile(planner.improved, **options)
    assert agent.act(torch.randn(2, 4), torch.ones(2, dtype=torch.bool)).abs().max() <= 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"num_envs": 2},
            r"policy.num_envs=2 is less than one .* 3 tasks, .*\[a,b\]. Take policy.num_envs=3",
        ),
        ({"observation": "pixels"}, r"policy.tasks=\[a,b\] are learned .* from states.*Leave it out"),
    ],
)
def test_what_several_tasks_cannot_have_is_an_error(changes, message):
    with pytest.raises(PolicyError, match=message):
        Tdmpc2Config(tasks=("a", "b"), **changes)


def test_random_actions_come_first_in_every_task():
    assert Tdmpc2Config().first_steps(1000, 50) == 5000 + 1000
    assert Tdmpc2Config(seed_steps=7).first_steps(1000, 50) == 7
