"""What cameras do to images, on a GPU: the images of a CPU, and in observations that stay there."""

import numpy as np
import pytest
import torch

import envs
from envs.randomization.disturbances import disturb
from envs.randomization.sensor import CELLS, strengths_of
from envs.simulators.disturbed import DisturbedHandler

pytestmark = pytest.mark.gpu


def test_a_gpu_disturbs_images_as_a_cpu_does():
    """Every combination, together: sums and products of float32 round alike, so at most a tie differs."""
    rng = np.random.default_rng(0)
    sensors = [strengths_of(cell, rng) for cell in CELLS]
    smooth = torch.rand(len(CELLS), 3, 9, 9, generator=torch.Generator().manual_seed(0))
    images = torch.nn.functional.interpolate(smooth, size=(72, 72), mode="bilinear").permute(0, 2, 3, 1)
    images = (255 * images).to(torch.uint8).contiguous()
    frames = list(range(len(CELLS)))
    on_cpu = disturb(images, sensors, frames, "front")
    on_gpu = disturb(images.cuda(), sensors, frames, "front")
    assert on_gpu.device.type == "cuda" and on_gpu.dtype == torch.uint8
    apart = (on_gpu.cpu().int() - on_cpu.int()).abs()
    assert float((apart > 0).float().mean()) < 1e-3
    assert not torch.equal(on_cpu, images)


def test_images_that_stay_on_the_gpu_are_disturbed():
    env = envs.make_vec("PickCube", 4, only="sensor", simulator="mujoco_warp", image_size=32)
    env.reset_envs(np.arange(4), env.split_indices[:4])
    handler = env.handler
    assert isinstance(handler, DisturbedHandler)
    tensors = handler.render_tensors(handler.snapshot())["front"]["rgb"]
    clean = handler.handler.render_tensors()["front"]["rgb"]
    assert tensors.device.type == "cuda" and tensors.shape == (4, 32, 32, 3)
    assert all(not torch.equal(one, other) for one, other in zip(tensors, clean, strict=True))
    seen = env.observe()["observation.images.front"]
    assert np.array_equal(seen, tensors.cpu().numpy())
    env.close()
