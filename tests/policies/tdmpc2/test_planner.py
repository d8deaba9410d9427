"""Planning against the closed form of a linear-quadratic problem, and by hand."""

import numpy as np
import pytest
import scipy.linalg
import torch

from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import estimate_value, plan, prior_rollout, shifted

A = np.array([[1.0, 0.1], [0.0, 1.0]])
B = np.array([[0.005], [0.1]])
Q, R = np.diag([1.0, 0.1]), np.array([[0.05]])
P = scipy.linalg.solve_discrete_are(A, B, Q, R)
GAIN = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
SEARCH = Tdmpc2Config(
    num_samples=512, num_elites=32, num_pi_trajs=8, iterations=25, min_std=1e-4, max_std=1.0,
    temperature=200.0, horizon=3,
)  # fmt: skip


class LinearQuadratic:
    """A double integrator with quadratic costs; after the horizon, the optimal cost to go."""

    def __init__(self) -> None:
        self.A, self.B, self.Q, self.R, self.P = (torch.tensor(m).float() for m in (A, B, Q, R, P))

    def next(self, z, action, task=None):
        return z @ self.A.T + action @ self.B.T

    def reward(self, z, action, task=None):
        return -((z @ self.Q) * z).sum(-1) - ((action @ self.R) * action).sum(-1)

    def ended(self, z, task=None):
        return torch.zeros_like(z[..., 0])

    def prior(self, z, noise, task=None):
        mean = torch.zeros_like(noise)
        return (0.3 * noise).clamp(-1, 1), mean, noise.sum(-1)

    def values(self, z, action, task=None, *, members=None):
        return -((z @ self.P) * z).sum(-1)

    def action_mask(self, task):
        return None


def normal(seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    return lambda *shape: torch.randn(*shape, generator=generator)


def test_mppi_finds_the_riccati_solution():
    z = torch.tensor([[0.2, 0.0], [-0.2, 0.1], [0.1, -0.3], [0.0, 0.25]])
    expected = -z @ torch.tensor(GAIN.T).float()
    assert (expected.abs() < 0.9).all()  # the limits of the actions play no part
    found = plan(SEARCH, LinearQuadratic(), z, torch.zeros(4, 3, 1), 1.0, normal())
    torch.testing.assert_close(found.mean[:, 0], expected, atol=0.01, rtol=0.01)
    torch.testing.assert_close(found.action, expected, atol=0.02, rtol=0.02)
    assert (found.std < 0.05).all()


def test_the_value_of_the_optimal_sequence_is_the_optimal_cost():
    model, z = LinearQuadratic(), torch.tensor([[0.3, -0.1]])
    state, actions = z, []
    for _ in range(3):
        actions.append(-state @ torch.tensor(GAIN.T).float())
        state = model.next(state, actions[-1])
    sequence = torch.stack(actions, 1)[:, :, None]  # (1, 3, 1, 1)
    value = estimate_value(model, z, sequence, torch.zeros(1, 1, 1), 1.0)
    torch.testing.assert_close(value[0], -((z @ model.P) * z).sum(-1))


def test_environments_are_planned_for_side_by_side():
    z = torch.tensor([[0.3, 0.0], [-0.3, 0.0]])
    found = plan(SEARCH, LinearQuadratic(), z, torch.zeros(2, 3, 1), 1.0, normal())
    assert found.action[0] < 0 < found.action[1]


def test_rewards_after_the_end_of_an_episode_do_not_count():
    model = LinearQuadratic()
    model.ended = lambda z, task=None: torch.ones_like(z[..., 0])
    z, actions = torch.tensor([[1.0, 0.0]]), torch.full((1, 3, 1, 1), 0.5)
    value = estimate_value(model, z, actions, torch.zeros(1, 1, 1), 0.9)
    torch.testing.assert_close(value[0], model.reward(z, actions[:, 0, 0]))


def test_discounting_by_hand():
    model = LinearQuadratic()
    model.reward = lambda z, action, task=None: torch.ones_like(z[..., 0])
    model.values = lambda z, action, task=None, members=None: torch.full_like(z[..., 0], 8.0)
    value = estimate_value(model, torch.zeros(1, 2), torch.zeros(1, 3, 1, 1), torch.zeros(1, 1, 1), 0.5)
    assert float(value) == 1 + 0.5 + 0.25 + 0.125 * 8


def test_the_next_plan_starts_one_step_later():
    mean = torch.arange(12.0).reshape(2, 3, 2)
    start = shifted(mean, torch.tensor([False, True]))
    assert start[0].tolist() == [[2, 3], [4, 5], [0, 0]]
    assert not start[1].any()


def test_the_policy_prior_rolls_out_through_the_model():
    model, z = LinearQuadratic(), torch.tensor([[1.0, -1.0]])
    model.prior = lambda z, noise, task=None: (z[..., :1] + noise, z[..., :1], noise)
    actions = prior_rollout(model, z, torch.zeros(1, 2, 1, 1), mean=True)
    assert actions.flatten().tolist() == pytest.approx([1.0, 1.0 * 1.0 + 0.1 * -1.0 + 0.005 * 1.0])


def test_masked_entries_stay_zero():
    model = LinearQuadratic()
    model.next = lambda z, action, task=None: z
    model.reward = lambda z, action, task=None: action.sum(-1)
    mask = torch.tensor([[1.0, 0.0]])
    model.action_mask = lambda task: mask[task]
    found = plan(
        SEARCH,
        model,
        torch.zeros(2, 2),
        torch.zeros(2, 3, 2),
        1.0,
        normal(),
        torch.zeros(2, 1, dtype=torch.long),
    )
    assert (found.action[:, 0] > 0.9).all()
    assert not found.action[:, 1].any() and not found.mean[..., 1].any() and not found.std[:, 1].any()


def test_action_is_sampled_by_the_weights_of_the_elites():
    from policies.tdmpc2.planner import _drawn

    actions = torch.tensor([[[0.0], [1.0]]]).expand(4000, -1, -1)
    weights = torch.tensor([[0.2, 0.8]]).expand(4000, -1)
    assert float(_drawn(actions, weights, normal()).mean()) == pytest.approx(0.8, abs=0.03)
