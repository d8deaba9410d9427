"""Batch normalization as one operator."""

import copy

import pytest
import torch
from torch import nn

from policies.batch_norm import BatchNorm2d

MOMENTUM = 0.1


def networks():
    """The same small network with PyTorch's normalization and with ours."""
    torch.manual_seed(0)
    theirs = nn.Sequential(nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8, momentum=MOMENTUM), nn.ReLU())
    nn.init.uniform_(theirs[1].weight)
    nn.init.uniform_(theirs[1].bias)
    ours = copy.deepcopy(theirs)
    ours[1] = BatchNorm2d(8, momentum=MOMENTUM)
    ours[1].load_state_dict(theirs[1].state_dict())
    return theirs, ours


def step(network, pictures, precision):
    """Output, gradients and running statistics after a forward and backward."""
    with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
        output = network(pictures)
    (output.float() ** 3).mean().backward()
    gradients = {name: parameter.grad for name, parameter in network.named_parameters()}
    statistics = {key: value for key, value in network[1].named_buffers() if value.is_floating_point()}
    return output.detach(), gradients, statistics


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_it_learns_and_averages_as_pytorchs(precision, layout):
    theirs, ours = networks()
    pictures = torch.randn(4, 3, 9, 9).to(memory_format=layout)
    for _ in range(2):  # the second average depends on the first
        torch.testing.assert_close(step(ours, pictures, precision), step(theirs, pictures, precision))


def test_what_it_returns_has_no_mean_and_a_variance_of_one():
    norm = BatchNorm2d(2, momentum=MOMENTUM, eps=0.0)
    pictures = torch.tensor([1.0, 3.0, 10.0, 30.0]).reshape(1, 2, 2, 1)
    assert norm(pictures).flatten().tolist() == pytest.approx([-1.0, 1.0, -1.0, 1.0])
    # The variances of two samples are 2 and 200; a tenth of them, and nine tenths of the ones of before.
    assert norm.running_mean.tolist() == pytest.approx([0.2, 2.0])
    assert norm.running_var.tolist() == pytest.approx([1.1, 20.9])


def test_in_evaluation_it_is_pytorchs():
    theirs, ours = networks()
    pictures = torch.randn(2, 3, 9, 9)
    assert torch.equal(ours.eval()(pictures), theirs.eval()(pictures))


def test_its_operator_keeps_the_promises_that_a_compiler_builds_on():
    pictures = torch.randn(2, 4, 5, 5, requires_grad=True)
    weight, bias = torch.rand(4, requires_grad=True), torch.rand(4, requires_grad=True)
    torch.library.opcheck(torch.ops.roboverse.batch_norm.default, (pictures, weight, bias, 1e-5))
