"""Muon: what its updates are, which parameters get them, and that a resumed run keeps them."""

import pytest
import torch
from torch import nn

from roboverse_learn.training.checkpoint import load_moments, moments
from roboverse_learn.training.config import ConfigError, TrainConfig
from roboverse_learn.training.imitation.muon import MuonAdamW, orthogonalized
from roboverse_learn.training.imitation.optimizer import make_optimizer


@pytest.mark.parametrize("shape", [(4, 9), (9, 4), (5, 5)])
def test_an_update_keeps_the_singular_vectors_and_levels_the_singular_values(shape):
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(shape, generator=generator)
    left, _, right = torch.linalg.svd(matrix, full_matrices=False)
    (update,) = orthogonalized([matrix])
    levelled = left.T @ update @ right.T  # diagonal if the singular vectors are the same
    assert torch.allclose(levelled, torch.diag(levelled.diagonal()), atol=1e-3)
    # The authors' coefficients end within 0.3 of 1.
    assert ((levelled.diagonal() - 1.0).abs() < 0.35).all()


def test_matrices_of_one_size_do_not_influence_each_other():
    generator = torch.Generator().manual_seed(1)
    matrices = [torch.randn(shape, generator=generator) for shape in ((3, 7), (7, 3), (3, 5), (2, 2))]
    for together, matrix in zip(orthogonalized(matrices), matrices, strict=True):
        assert together.shape == matrix.shape
        assert torch.allclose(together, orthogonalized([matrix])[0], atol=1e-5)


def test_the_first_step_of_a_rank_one_gradient_by_hand():
    """The update of u vᵀ is u vᵀ of length about 1, times lr · 0.2 · √max(rows, columns)."""
    weight = nn.Parameter(torch.zeros(2, 4))
    optimizer = MuonAdamW([{"params": [weight], "muon": True}], lr=0.1, weight_decay=0.0)
    weight.grad = torch.tensor([[0.0, 0.0, 5.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    optimizer.step()
    moved = weight.detach().clone()
    assert -0.1 * 0.2 * 2.0 * 1.3 < moved[0, 2] < -0.1 * 0.2 * 2.0 * 0.65
    moved[0, 2] = 0.0
    assert not moved.any()


def test_the_gradients_size_does_not_matter():
    weights = []
    for scale in (1e-3, 1e3):
        weight = nn.Parameter(torch.ones(3, 3))
        optimizer = MuonAdamW([{"params": [weight], "muon": True}], lr=0.1)
        weight.grad = scale * torch.eye(3)[[1, 2, 0]]
        optimizer.step()
        weights.append(weight.detach())
    assert torch.allclose(*weights, atol=1e-6)


class Model(nn.Module):
    def __init__(self):
        super().__init__()
        self.backbone = nn.Linear(3, 3)
        self.hidden = nn.Linear(3, 3)
        self.queries = nn.Parameter(torch.zeros(3, 3))
        self.action_head = nn.Linear(3, 3)


class Policy:
    def __init__(self):
        torch.manual_seed(0)
        self.model = Model()

    def parameter_groups(self):
        return []


def test_only_matrices_of_hidden_linear_layers_are_trained_by_muon():
    policy = Policy()
    optimizer = make_optimizer(policy, TrainConfig(lr=1e-3, lr_backbone=1e-4, lr_muon=5e-3))
    rates = {id(p): group["peak_lr"] for group in optimizer.param_groups for p in group["params"]}
    by_name = {name: rates[id(p)] for name, p in policy.model.named_parameters()}
    assert by_name.pop("hidden.weight") == 5e-3
    assert by_name.pop("backbone.weight") == by_name.pop("backbone.bias") == 1e-4
    assert set(by_name.values()) == {1e-3}


class Grouped(Policy):
    name = "lerobot"

    def parameter_groups(self):
        backbone = [self.model.backbone.weight, self.model.backbone.bias]
        return [(backbone, 0.1), ([self.model.queries, self.model.action_head.weight], 1.0)]


def test_a_rate_of_the_backbone_is_refused_by_a_policy_with_groups_of_its_own():
    with pytest.raises(
        ConfigError, match=r"policy=lerobot .* takes no train\.lr_backbone, given 0\.002\. Le"
    ):
        make_optimizer(Grouped(), TrainConfig(lr_backbone=2e-3))
    backbone, rest = make_optimizer(Grouped(), TrainConfig(lr=1e-3)).param_groups
    assert (backbone["peak_lr"], rest["peak_lr"]) == (1e-4, 1e-3)
    assert not backbone["muon"] and not rest["muon"]


def test_each_group_of_a_policys_own_has_its_share_of_muons_rate():
    policy = Grouped()
    groups = make_optimizer(policy, TrainConfig(lr=1e-3, lr_muon=5e-3)).param_groups
    model = policy.model
    assert [(group["peak_lr"], group["muon"]) for group in groups] == [
        (1e-4, False),
        (5e-4, True),
        (1e-3, False),
    ]
    expected = [[model.backbone.bias], [model.backbone.weight], [model.queries, model.action_head.weight]]
    for group, members in zip(groups, expected, strict=True):
        assert [id(each) for each in group["params"]] == [id(each) for each in members]


def test_a_matrix_that_is_also_an_embedding_is_left_to_adamw():
    policy = Grouped()
    policy.model.embedding = nn.Embedding(3, 3)
    policy.model.embedding.weight = policy.model.backbone.weight
    assert not any(group["muon"] for group in make_optimizer(policy, TrainConfig(lr_muon=5e-3)).param_groups)


def test_without_its_learning_rate_every_parameter_is_trained_by_adamw():
    policy, reference = Policy(), Policy()
    optimizer = make_optimizer(policy, TrainConfig(lr=1e-2))
    adamw = torch.optim.AdamW(reference.model.parameters(), lr=1e-2, weight_decay=1e-4, fused=True)
    for _ in range(3):
        for model, each in ((policy.model, optimizer), (reference.model, adamw)):
            for parameter in model.parameters():
                parameter.grad = parameter.detach() + 1.0
            each.step()
    for ours, theirs in zip(policy.model.parameters(), reference.model.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_a_restored_optimizer_takes_the_same_next_step():
    def step(policy, optimizer):
        for i, parameter in enumerate(policy.model.parameters()):
            parameter.grad = torch.sin(parameter.detach() * 7 + i)
        optimizer.step()

    config = TrainConfig(lr=1e-2, lr_muon=1e-2)
    first, second = Policy(), Policy()
    optimizer = make_optimizer(first, config)
    for _ in range(2):
        step(first, optimizer)
    second.model.load_state_dict(first.model.state_dict())
    restored = make_optimizer(second, config)
    load_moments(restored, moments(optimizer, "optimizer"), "optimizer")
    step(first, optimizer)
    step(second, restored)
    for ours, theirs in zip(first.model.parameters(), second.model.parameters(), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("rate", [-1e-3, float("nan")])
def test_a_learning_rate_that_is_none_is_refused(rate):
    with pytest.raises(ConfigError, match="lr_muon"):
        TrainConfig(lr_muon=rate)
