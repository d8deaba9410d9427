"""A network with packed convolutions computes what the network does."""

import pytest
import torch
from torch import nn
from torchvision.models import resnet18, resnet50
from torchvision.ops.misc import FrozenBatchNorm2d

from policies.packed_convolutions import PackedConv2d, packed

needs_onednn = pytest.mark.skipif(not torch.backends.mkldnn.is_available(), reason="packs with oneDNN")


def images(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(2))


def backbone(make) -> nn.Module:
    """Returns a ResNet whose frozen normalization changes what it sees."""
    torch.manual_seed(0)
    network = make(norm_layer=FrozenBatchNorm2d).eval()
    for norm in network.modules():
        if isinstance(norm, FrozenBatchNorm2d):
            for name, tensor in norm.named_buffers():
                spread = torch.rand_like(tensor) - 0.5
                tensor += spread if name in ("weight", "running_var") else 0.2 * spread
    return network


def kinds(network: nn.Module) -> set[type]:
    return {type(module) for module in network.modules()}


@pytest.mark.slow
@needs_onednn
@pytest.mark.parametrize("make", [resnet18, resnet50])
def test_a_resnet_answers_the_same_but_for_rounding(make):
    network, seen = backbone(make), images(1, 3, 64, 64)
    quick = packed(network)
    with torch.inference_mode():
        expected = network(seen)
        for _ in range(2):  # the first call packs
            torch.testing.assert_close(
                quick(seen), expected, rtol=1e-4, atol=1e-5 * float(expected.abs().max())
            )
    assert not {nn.Conv2d, FrozenBatchNorm2d} & kinds(quick)
    assert {nn.Conv2d, FrozenBatchNorm2d} < kinds(network)


@needs_onednn
@pytest.mark.parametrize(
    "convolution",
    [
        nn.Conv2d(8, 16, 3, padding=1),
        nn.Conv2d(8, 16, 7, stride=2, padding=3, bias=False),
        nn.Conv2d(8, 16, 1, stride=2),
        nn.Conv2d(8, 16, 3, padding=(2, 1), dilation=2),
        nn.Conv2d(8, 16, 3, groups=4),
        nn.Conv2d(8, 16, 3, padding="valid"),
    ],
    ids=str,
)
def test_a_convolution_packed_for_one_image_takes_any(convolution):
    quick = PackedConv2d(convolution)
    for shape in ((1, 8, 16, 16), (4, 8, 16, 16), (2, 8, 9, 33)):
        with torch.inference_mode():
            torch.testing.assert_close(quick(images(*shape)), convolution(images(*shape)))


@pytest.mark.parametrize("convolution", [nn.Conv2d(4, 4, 3, padding=1, padding_mode="circular"),
                                         nn.Conv2d(4, 4, 3, padding="same")], ids=str)  # fmt: skip
def test_padding_that_is_not_packed_stays_right(convolution):
    with torch.inference_mode():
        seen = images(1, 4, 8, 8)
        torch.testing.assert_close(packed(nn.Sequential(convolution))(seen), convolution(seen))


def test_a_norm_is_folded_only_into_a_convolution_before_it():
    network = nn.Sequential(FrozenBatchNorm2d(3), nn.Conv2d(3, 3, 3), nn.ReLU(), FrozenBatchNorm2d(3)).eval()
    for name, tensor in network.named_buffers():
        tensor += 1.0 if name.endswith("bias") else 0.0
    seen = images(1, 3, 8, 8)
    with torch.inference_mode():
        torch.testing.assert_close(packed(network)(seen), network(seen))
