"""Group normalization with channels last is PyTorch's, in another layout."""

import pytest
import torch
from torch import nn

from policies.group_norm import ChannelsLastGroupNorm
from tests.policies.examples import make

pytestmark = pytest.mark.slow


def images():
    return torch.randn(3, 32, 5, 7).to(memory_format=torch.channels_last)


def norms():
    plain = nn.GroupNorm(2, 32)
    nn.init.normal_(plain.weight)
    nn.init.normal_(plain.bias)
    return plain, ChannelsLastGroupNorm.of(plain)


@pytest.mark.parametrize("backend", [None, "aot_eager"])
def test_what_is_computed_is_pytorchs(backend):
    plain, norm = norms()
    inputs = images()
    function = norm if backend is None else torch.compile(norm, backend=backend, fullgraph=True)
    answers = []
    for network in (plain, function):
        given = inputs.clone().requires_grad_()
        plain.zero_grad()
        answer = network(given)
        (answer * torch.linspace(-1.0, 1.0, answer.numel()).view_as(answer)).sum().backward()
        answers.append((answer, given.grad, plain.weight.grad.clone(), plain.bias.grad.clone()))
    for theirs, ours in zip(*answers, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-5)


def test_two_samples_by_hand():
    """A group of (1, 3) has the mean 2 and the deviation 1; scaled by 2 and moved by 5 it is (3, 7)."""
    norm = ChannelsLastGroupNorm(1, 2, eps=0.0)
    nn.init.constant_(norm.weight, 2.0)
    nn.init.constant_(norm.bias, 5.0)
    compiled = torch.compile(norm, backend="aot_eager", fullgraph=True)
    given = torch.tensor([1.0, 3.0, 10.0, 30.0]).view(2, 2, 1, 1)
    assert compiled(given).flatten().tolist() == pytest.approx([3.0, 7.0, 3.0, 7.0])


def test_layout_and_precision_stay_where_it_is_compiled():
    _, norm = norms()
    compiled = torch.compile(norm, backend="aot_eager", fullgraph=True)
    answer = compiled(images().bfloat16())
    assert answer.dtype is torch.bfloat16
    assert answer.is_contiguous(memory_format=torch.channels_last)


def test_diffusion_policy_trains_with_it_and_is_saved_without(tmp_path):
    policy = make("diffusion")
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    policy.begin_training()
    policy.begin_training()  # as a resumed run
    norms = [m for m in policy.model.modules() if isinstance(m, ChannelsLastGroupNorm)]
    assert len(norms) == 20, "of a ResNet18"
    after = policy.state_dict()
    assert list(after) == list(before)
    assert all(after[name].equal(value) for name, value in before.items())
    policy.save(tmp_path / "policy")
    loaded = type(policy).load(tmp_path / "policy")
    assert not any(isinstance(m, ChannelsLastGroupNorm) for m in loaded.model.modules())
