"""Random changes of images on a GPU."""

import pytest
import torch

from roboverse_learn.training.config import AugmentConfig
from roboverse_learn.training.imitation.image_augmentation import augment

pytestmark = pytest.mark.gpu

ALL = AugmentConfig(
    shift_px=4, brightness=0.5, contrast=0.3, saturation=0.3, hue=0.05, convolution=0.3, overlay=0.3,
    tone=0.5, shadow=0.5,
)  # fmt: skip


def test_nothing_waits_for_the_gpu():
    images = torch.randint(0, 256, (16, 3, 32, 32), dtype=torch.uint8, device="cuda")
    augment(images, ALL)  # what is constant is copied once
    torch.cuda.set_sync_debug_mode("error")
    try:
        changed = augment(images, ALL)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert changed.shape == images.shape and 0.0 <= float(changed.min()) <= float(changed.max()) <= 1.0
