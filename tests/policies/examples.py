"""Tiny policies and the features they are made for."""

from dataclasses import replace

import numpy as np
import torch
import torchvision
from torchvision.models.resnet import BasicBlock, ResNet

import policies
from policies.act.config import ActConfig
from policies.diffusion.config import DiffusionConfig
from policies.mtact.config import MtActConfig

SIZE = 32
IMAGE = "observation.images.front"
FEATURES = {
    IMAGE: {"dtype": "video", "shape": (SIZE, SIZE, 3), "names": ["height", "width", "channels"]},
    "observation.state": {"dtype": "float32", "shape": (9,), "names": None},
    "action": {"dtype": "float32", "shape": (9,), "names": None},
    "timestamp": {"dtype": "float32", "shape": (1,), "names": None},
}
CONFIGS = {
    "act": ActConfig(
        chunk_size=6, n_action_steps=4, dim_model=32, n_heads=2, dim_feedforward=64, n_encoder_layers=1,
        n_vae_encoder_layers=1, latent_dim=4, dropout=0.0,
    ),
    "diffusion": DiffusionConfig(
        n_obs_steps=2, horizon=8, n_action_steps=4, down_dims=(32, 64), num_train_timesteps=8,
    ),
    "mtact": MtActConfig(
        chunk_size=6, n_action_steps=4, dim_model=32, n_heads=2, dim_feedforward=64, n_encoder_layers=1,
        n_decoder_layers=1, conv_channels=(8, 16), n_keypoints=4, tokens_per_camera=1, num_buckets=64,
    ),
}  # fmt: skip

LEARNED = [name for name in policies.names("dataset") if name in CONFIGS]
"""Policies that learn from a dataset by this package alone: no weights, tokenizer or extra of others."""


NARROW, SHALLOW = "resnet18_narrow", "resnet10_narrow"


class NarrowResNet(ResNet):
    """A ResNet18 with a quarter of the channels: of a tiny policy's time, nearly all is the backbone's."""

    def __init__(self, blocks: int = 2, **kwargs) -> None:
        super().__init__(BasicBlock, [blocks] * 4, **kwargs)
        self.fc = torch.nn.Linear(512 // 4, 1000)

    def _make_layer(self, block, planes, *args, **kwargs):
        return super()._make_layer(block, planes // 4, *args, **kwargs)


def _narrow(weights=None, **kwargs) -> NarrowResNet:
    assert weights is None
    return NarrowResNet(**kwargs)


def _shallow(weights=None, **kwargs) -> NarrowResNet:
    return _narrow(weights, blocks=1, **kwargs)


setattr(torchvision.models, NARROW, _narrow)  # where LeRobot looks the name up
setattr(torchvision.models, SHALLOW, _shallow)

NARROW_CONFIGS = {name: replace(config, vision_backbone=NARROW) for name, config in CONFIGS.items()}
"""For tests that train, save and resume a policy."""


def stats() -> dict:
    rng = np.random.default_rng(3)
    low = rng.uniform(-1.0, 0.0, 9).astype(np.float32)
    vector = {"mean": low + 0.5, "std": np.full(9, 0.3, np.float32), "min": low, "max": low + 1.0}
    image = {"mean": np.full((3, 1, 1), 0.4), "std": np.full((3, 1, 1), 0.2), "min": np.zeros((3, 1, 1)),
             "max": np.ones((3, 1, 1))}  # fmt: skip
    return {IMAGE: image, "observation.state": vector, "action": vector}


def make(name: str, **changes):
    return policies.create(name, FEATURES, stats(), replace(CONFIGS[name], **changes))


def observation(policy, n: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    time = (policy.n_obs_steps,) if policy.n_obs_steps > 1 else ()
    return {
        IMAGE: rng.integers(0, 256, (n, *time, SIZE, SIZE, 3), np.uint8),
        "observation.state": rng.normal(size=(n, *time, 9)).astype(np.float32),
        "task": np.array(["pick up the cube"] * n),
    }


def generators(n: int, seed: int = 0) -> list[torch.Generator]:
    return [torch.Generator().manual_seed(1000 * seed + i) for i in range(n)]
