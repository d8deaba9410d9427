"""Images to keypoints: convolutions with group normalization, then spatial softmax (arXiv:1504.00702).

With three convolutions its maps of features have an eighth of the side of an image, where those of a ResNet
have a thirty-second: a keypoint of a small image says where a thing is.

Shape legend: B = samples, C, H, W = an image, K = keypoints.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

_NORM_GROUPS = 8


class KeypointBackbone(nn.Module):
    """Images to the coordinates of keypoints.

    Args:
        in_channels: Channels of an image.
        channels: Channels of each convolution.
        n_keypoints: Keypoints.
        n_residual_blocks: Residual blocks between the convolutions and the heatmaps.
    """

    def __init__(
        self, in_channels: int, channels: tuple[int, ...], n_keypoints: int, n_residual_blocks: int = 0
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for i, width in enumerate(channels):
            # Large steps over the pixels first: the full resolution is what costs a CPU most.
            kernel, stride = (6, 4) if i == 0 else (3, 2 if i < len(channels) - 1 else 1)
            layers += [
                nn.Conv2d(in_channels, width, kernel, stride, padding=1),
                nn.GroupNorm(_NORM_GROUPS, width),
                nn.ReLU(inplace=True),
            ]
            in_channels = width
        layers += [ResidualBlock(in_channels) for _ in range(n_residual_blocks)]
        self.features = nn.Sequential(*layers)
        self.heatmaps = nn.Conv2d(in_channels, n_keypoints, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Returns the keypoints of images (B, C, H, W): rows, then columns, from -1 to 1, (B, 2 K)."""
        return spatial_softmax(self.heatmaps(self.features(images)))


class ResidualBlock(nn.Module):
    """Two convolutions whose result is added to what they see; at first it is zero.

    Args:
        channels: Channels of what it sees and returns.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        last = nn.GroupNorm(_NORM_GROUPS, channels)
        nn.init.zeros_(last.weight)
        self.layers = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.GroupNorm(_NORM_GROUPS, channels),
            nn.ReLU(inplace=True),
            nn.Conv2d(channels, channels, 3, padding=1),
            last,
        )

    def forward(self, maps: Tensor) -> Tensor:
        """Returns maps of the same shape, (B, C, H, W)."""
        return functional.relu(maps + self.layers(maps))


def spatial_softmax(maps: Tensor) -> Tensor:
    """Returns the keypoints of heatmaps (B, K, H, W): rows, then columns, from -1 to 1, (B, 2 K)."""
    with torch.autocast(maps.device.type, enabled=False):
        weights = maps.float().flatten(2).softmax(-1).view_as(maps)
        rows, columns = (torch.linspace(-1, 1, size, device=maps.device) for size in maps.shape[2:])
        return torch.cat([weights.sum(3) @ rows, weights.sum(2) @ columns], 1)
