"""The comparison of training steps, on a CPU: both sides run, and lose alike."""

import pytest

from roboverse_learn.speed import BENCHMARKS
from roboverse_learn.speed.training import GPU, SAME_LOSS, Compilation, Frames, Scale, measure

TINY = Scale(batch_size=2, image_size=32, num_frames=8, steps=1, turns=1, compared=2)


def test_it_is_registered_and_a_gpu_gets_what_was_promised():
    assert BENCHMARKS.entry("training").target == "roboverse_learn.speed.training"
    assert (GPU.batch_size, GPU.image_size) == (256, 256)


def test_a_batch_is_the_same_whenever_it_is_asked_for():
    frames = Frames(TINY, {"action": [0, 1, 2]}, "cpu")
    first, again, other = frames.batch(3), frames.batch(3), frames.batch(4)
    assert first["action"].shape == (2, 3, 9)
    assert first["action_is_pad"].shape == (2, 3)
    assert all(first[key].equal(again[key]) for key in first)
    assert not first["observation.state"].equal(other["observation.state"])


@pytest.mark.long
@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_both_sides_lose_alike(name):
    measurement, apart = measure(name, TINY, "cpu", Compilation(enabled=False))
    assert apart < SAME_LOSS
    assert measurement.ours_s > 0 < measurement.baseline_s
    assert measurement.name.startswith(f"training step of {name}, batch 2, 32×32, bf16 on cpu")
